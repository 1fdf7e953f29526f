"""The protocol between a cell's process and the simulation, on CPython and MicroPython alike.

They take turns at a block of memory that both see. The simulation writes its input for the cell
into it, and one byte into a pipe: the command. The process obeys, writes the result into the block,
and answers by one byte through another pipe: whether there is anything in its outbox. The end of a
pipe means that the other is gone.

A block is `WORDS` 32-bit numbers, the registers of the speed loop, an inbox and an outbox of
frames: identifier, size, data. The inbox is taken in before anything else is done. Frames stay in
the outbox until a request says that they were `TAKEN`.

Two entries of the outbox have an identifier that no frame has. They come first, after a change.
`LISTENS` has the identifiers that the cell takes from now on. `SILENT` has those that it sends
nothing about before its next tick. Their frames may lie in the inbox until then.
"""

# Requests
NOTHING = 0
TICK = 1
RESTART = 2
LEAVE_BUS = 3
REJOIN_BUS = 4
#: Added to a request: the frames in the outbox need not be sent again.
TAKEN = 0x80

# Where the words of a block are, counted in words
PRESENCE = 0
NOW_MS = 1
VOLTAGES_UV = 2  # both axes
INBOX_SIZE = 4  # bytes
OUTBOX_SIZE = 5  # bytes
NODE_ID = 6  # from RESTART on
BLINKING = 7  # whether the LEDs show that this is the cell meant
PLACE = 8  # the node id that belongs to the place, 0 if the table does not tell
WORDS = 16

# Where the parts of a block are, in bytes
WORD = 4
REGISTERS = WORDS * WORD
INBOX = 1024
INBOX_MAX = 1024
OUTBOX = INBOX + INBOX_MAX
OUTBOX_MAX = 4096
BLOCK = OUTBOX + OUTBOX_MAX

FRAME_HEAD_SIZE = 3
FRAME_MAX = 11
LISTENS = 0xFFFF
SILENT = 0xFFFE
