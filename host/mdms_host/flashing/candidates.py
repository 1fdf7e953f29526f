"""The cells' statements before they are updated:

their firmware, the bundles that they take, and why some take none.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from mdms_host.can_link import boards
from mdms_host.commissioning.network import (
    NO_IDENTITY,
    Commissioning,
    CommissioningError,
    Identity,
    RefusedError,
    SilentError,
)
from mdms_protocol import indices
from mdms_protocol.codecs import update

_USB = "USB it is: mdms flash"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A cell, the firmware that runs, and what its board takes; `refusal` is why it takes none.

    `identification` is that of the bundle that it runs, 0 for firmware that USB has brought.
    `on_trial` is whether it goes back to the firmware before unless somebody confirms that bundle.
    """

    node_id: int
    identity: Identity
    identification: int = 0
    key_id: bytes = b""
    board: int = update.UNKNOWN_BOARD
    bytecode: int = 0
    room: int = 0
    counter: int = 0
    on_trial: bool = False
    refusal: str | None = None

    @property
    def board_name(self) -> str:
        """The board in words."""
        return boards.NAMES.get(self.board, f"board {self.board}")


def read_candidates(
    commissioning: Commissioning, node_ids: Iterable[int], progress: Callable[[float], None]
) -> list[Candidate]:
    """All cells among these nodes; other nodes are left out.

    A cell that gives no answer, or refuses one, takes nothing.
    """
    found = []
    wanted = list(node_ids)
    for done, node_id in enumerate(wanted, 1):
        identity = NO_IDENTITY
        try:
            identity = commissioning.identity(node_id)
            if identity.is_cell:
                found.append(read_candidate(commissioning, node_id, identity))
        except CommissioningError as error:
            # A node that says nothing may be a cell.
            if identity.is_cell or isinstance(error, SilentError):
                found.append(
                    Candidate(
                        node_id, identity, refusal=str(error).removeprefix(f"node {node_id}, ")
                    )
                )
        progress(done / len(wanted))
    return found


def read_candidate(commissioning: Commissioning, node_id: int, identity: Identity) -> Candidate:
    """The statement of a cell about its firmware. Raises CommissioningError."""
    try:
        board = commissioning.read(node_id, indices.UPDATE, 3)
        room = commissioning.read(node_id, indices.UPDATE, 5)
    except RefusedError:
        refusal = f"firmware {identity.software} takes none over the bus yet; {_USB}"
        return Candidate(node_id, identity, refusal=refusal)
    if not room:
        name = boards.NAMES.get(board, f"board {board}")
        refusal = f"{name} has no room for a second firmware beside the first; {_USB}"
        return Candidate(node_id, identity, board=board, refusal=refusal)
    return Candidate(
        node_id,
        identity,
        identification=commissioning.read(node_id, indices.PROGRAM_IDENTIFICATION, 1),
        key_id=commissioning.read(node_id, indices.UPDATE, 2).to_bytes(4, "little"),
        board=board,
        bytecode=commissioning.read(node_id, indices.UPDATE, 4),
        room=room,
        counter=commissioning.read(node_id, indices.UPDATE, 6),
        on_trial=bool(commissioning.read(node_id, indices.UPDATE, 8)),
    )


class KeyRefusedError(CommissioningError):
    """A cell has another array's key."""


def give_key(
    commissioning: Commissioning, candidate: Candidate, key: bytes, identification: bytes
) -> bool:
    """Have a cell keep the array's key; False if it has it. Raises KeyRefusedError, SilentError."""
    if candidate.key_id == identification:
        return False
    if any(candidate.key_id):
        raise KeyRefusedError(
            f"node {candidate.node_id} has another array's key; at its USB prompt: "
            "mpremote fs rm :update.key"
        )
    commissioning.write_bytes(candidate.node_id, indices.UPDATE, 1, key)
    return True
