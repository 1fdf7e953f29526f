"""A box is shown to a camera, a little turned, and comes back."""

SCENARIO = "transport.toml"


async def main(table):
    """The camera looks at the east end."""
    box = table["box"]
    home = box.pose
    await box.move(0.05, 0.0, -0.2)
    await table.sleep(0.3)
    await box.move(*home)
