"""A box is carried by hand, without a program: each call returns when the box is there.

python examples/by_hand.py              in virtual time, with no hardware
python examples/by_hand.py array.toml   the table of an array file, with python-can's own settings
"""

import sys

import mdms_array as mdms


def carry(table: mdms.BlockingTable) -> None:
    """There, turned on the way, and back."""
    box = table["box"]
    box.move(0.10, 0.0, yaw_rad=0.2)  # x [m], y [m; table frame]
    box.move(-0.10, 0.0)
    print(table.run_so_far)


if __name__ == "__main__":
    with mdms.connect(sys.argv[1]) if sys.argv[1:] else mdms.virtual("array18") as chosen:
        carry(chosen)
