"""Parcels leave by the exit for their kind; every second one is taken out for inspection.

mdms simulate examples/sort.py          in virtual time, with no hardware
mdms run examples/sort.py -i socketcan -c can0
"""

SCENARIO = "infeed18.toml"


async def main(table):
    """Two parcels, as they come."""
    number = 0
    async for parcel in table.arrivals(2):
        number += 1
        # Each goes its way beside the others: the next may set out before it has left.
        leaving = table.start(parcel.leave("north" if number == 2 else None))
    await leaving
