"""A box is shown to a camera from two sides, and comes back."""

SCENARIO = "transport.toml"


async def main(table):
    """The camera looks at the east end."""
    box = table["box"]
    home = box.pose
    for yaw_rad in (-0.2, 0.2):
        await table.move(box, 0.12, 0.0, yaw_rad)
        await table.sleep(0.5)
    await table.move(box, *home)
