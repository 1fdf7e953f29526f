"""The text of an array file, the same for the same array: fit for version control."""

from collections.abc import Iterator

from mdms_host.commissioning.array_file import ArrayFile, FiledCell, FiledTable
from mdms_host.commissioning.filed_places import without_places
from mdms_model.scenario.scenario import Stop

#: The first line of every such file, by which it is known for one that may be written over.
MARK = "# Array, commissioned by `mdms commission`."
_HEAD = f"""{MARK} It takes the same file again: --from FILE.
# `mdms run --array` and `mdms configure load` read it too. Cells stand in the order of their
# places; settings are in SI units, and only those that are not at their defaults.
"""


def array_document(file: ArrayFile) -> str:
    """All that a file says, cells by their numbers, without what their places imply."""
    lines = [_HEAD, "[array]", *_table(file.table)]
    if file.stop is not None:
        lines += ["", *_stop(file.stop)]
    for cell in sorted(file.cells, key=lambda each: (each.number or each.node_id, each.serial)):
        lines += ["", *_cell(without_places(cell))]
    return "\n".join(lines) + "\n"


def _table(table: FiledTable) -> Iterator[str]:
    for name in ("columns", "rows", "pitch_m", "bitrate"):
        value = getattr(table, name)
        if value is not None:
            yield f"{name} = {value}"
    if table.channels:
        yield f"channels = [{', '.join(map(_quoted, table.channels))}]"
    if table.sensor_offset_m:
        yield f"sensor_offset_m = [{', '.join(map(_vector, table.sensor_offset_m))}]"
    for wheel in table.wheel or ():
        yield ""
        yield "[[array.wheel]]"
        yield f"direction_rad = {wheel.direction_rad}"
        yield f"offset_m = {_vector(wheel.offset_m)}"


def _stop(stop: Stop) -> Iterator[str]:
    yield "[stop]"
    yield f'form = "{stop.form}"'
    yield f"mass_kg = {stop.mass_kg}"
    yield f"speed_m_s = {stop.speed_m_s}"


def _cell(cell: FiledCell) -> Iterator[str]:
    yield "[[cell]]"
    yield f'serial = "{cell.serial:08X}"'
    yield f"node = {cell.node_id}"
    if cell.bus:
        yield f"bus = {cell.bus}"
    for name in ("number", "column", "row"):
        value = getattr(cell, name)
        if value is not None:
            yield f"{name} = {value}"
    for parameter, number in sorted(cell.values.items(), key=lambda item: item[0].place):
        line = f"settings.{parameter.name} = {parameter.text(number, unit=False)}"
        yield f"{line}  # {parameter.unit}" if parameter.unit else line


def _vector(numbers: tuple[float, float]) -> str:
    return f"[{', '.join(map(str, numbers))}]"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
