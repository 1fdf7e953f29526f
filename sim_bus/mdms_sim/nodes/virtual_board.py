"""The board of a simulated cell, on CPython and MicroPython alike."""

from mdms_cell import speed_loop

#: Frames that a board keeps when the bus does not take them.
TRANSMIT_QUEUE = 64


class VirtualBoard:
    """Peripherals as plain attributes: the simulation writes the inputs and takes the outputs."""

    def __init__(self, registers: memoryview) -> None:
        self.registers = registers
        self.counts = [0, 0]
        self.presence_bits = 0
        self.voltages_uv = [0, 0]
        self.frames: list[tuple[int, bytes]] = []
        self.cut = False

    def sample(self, registers: memoryview) -> None:
        """Write the encoder counts into the registers."""
        registers[speed_loop.COUNT] = self.counts[0]
        registers[speed_loop.AXIS + speed_loop.COUNT] = self.counts[1]

    def drive(self, registers: memoryview) -> None:
        """Apply the voltages [uV] found in the registers."""
        self.voltages_uv[0] = registers[speed_loop.VOLTAGE]
        self.voltages_uv[1] = registers[speed_loop.AXIS + speed_loop.VOLTAGE]

    def presence(self) -> int:
        """Return the five presence bits."""
        return self.presence_bits

    def send(self, can_id: int, data: bytes) -> bool:
        """Queue a frame; False when there is no room."""
        if len(self.frames) >= TRANSMIT_QUEUE:
            return False
        self.frames.append((can_id, bytes(data)))
        return True

    def motors_off(self) -> None:
        """Cut the drive until the next tick drives again."""
        self.cut = True
        self.voltages_uv[0] = 0
        self.voltages_uv[1] = 0
