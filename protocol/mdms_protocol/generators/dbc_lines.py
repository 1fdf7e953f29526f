"""Messages, signals and names of values as lines of a CAN database (DBC)."""

NOBODY = "Vector__XXX"


class Database:
    """A file in the making: messages, and names of values, which come after them."""

    def __init__(self) -> None:
        self._messages: list[str] = []
        self._values: list[str] = []

    def message(self, can_id: int, name: str, length: int, sender: str = NOBODY) -> None:
        """Begin a message."""
        self._messages += ["", f"BO_ {can_id} {name}: {length} {sender}"]

    def signal(
        self,
        name: str,
        start: int,
        bits: int,
        *,
        when: str = "",
        sign: str = "+",
        scale: str = "(1,0) [0|0]",
        unit: str = "",
        receiver: str = NOBODY,
    ) -> None:
        """Add a little-endian signal to the message.

        `when` is "M" for the signal that selects others, "m1" for a signal that exists if that is
        1.
        """
        shown = f"{name} {when}".rstrip()
        self._messages.append(f' SG_ {shown} : {start}|{bits}@1{sign} {scale} "{unit}" {receiver}')

    def names(self, can_id: int, signal: str, names: dict[int, str]) -> None:
        """Name the values of a signal."""
        pairs = " ".join(f'{value} "{text}"' for value, text in sorted(names.items()))
        self._values.append(f"VAL_ {can_id} {signal} {pairs} ;")

    def text(self, nodes: list[str]) -> str:
        """The whole file, with the names of all nodes."""
        head = ['VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {' '.join(nodes)}"]
        return "\n".join([*head, *self._messages, "", *self._values]) + "\n"
