"""Programs for a table: parcels come, are moved, and leave.

A program is a coroutine of a `Table`. An `await` takes as long as the table takes for it, in
simulated time as in real time. A started coroutine goes on beside all else:

    async def main(table):
        async for parcel in table.arrivals():
            table.start(parcel.leave())        # by the exit for its kind

`tasks` has the usual jobs; files of tasks (TOML) are made of the same.
"""
