"""The object table as an electronic data sheet (CiA 306), for commissioning tools.

CiA 306 has no key for units: they stand in its section of comments, one line an entry.
"""

from mdms_protocol import dictionary as d
from mdms_protocol import entry as e

_MANDATORY = (0x1000, 0x1001, 0x1018)
_DUMMIES = (2, 3, 4, 5, 6, 7)
_BIT_RATES_KBIT_S = (10, 20, 50, 125, 250, 500, 800, 1000)
#: Dates of the data sheet, month first (CiA 306); the second goes with `dictionary.REVISION`.
_CREATED = "11-21-2026"
_MODIFIED = "11-22-2026"
_AUTHOR = "mdms-array"


def text() -> str:
    """The whole data sheet; the same table gives the same text."""
    return "\n".join([*_head(), *_dummies(), *_comments(), *_lists(), *_sections()]) + "\n"


def _head() -> list[str]:
    return [
        "[FileInfo]",
        "FileName=mdms-cell.eds",
        "FileVersion=1",
        "FileRevision=0",
        "EDSVersion=4.0",
        f"Description={d.DEVICE_NAME}, a velocity drive of two wheels",
        "CreationTime=12:00AM",
        f"CreationDate={_CREATED}",
        f"CreatedBy={_AUTHOR}",
        "ModificationTime=12:00AM",
        f"ModificationDate={_MODIFIED}",
        f"ModifiedBy={_AUTHOR}",
        "",
        "[DeviceInfo]",
        "VendorName=",
        f"VendorNumber=0x{d.VENDOR_ID:08X}",
        f"ProductName={d.DEVICE_NAME}",
        f"ProductNumber=0x{d.PRODUCT_CODE:08X}",
        f"RevisionNumber=0x{d.REVISION:08X}",
        "OrderCode=",
        *(f"BaudRate_{rate}={int(rate == 1000)}" for rate in _BIT_RATES_KBIT_S),
        "SimpleBootUpMaster=0",
        "SimpleBootUpSlave=1",
        "Granularity=8",
        "DynamicChannelsSupported=0",
        "GroupMessaging=0",
        f"NrOfRXPDO={d.PDOS}",
        f"NrOfTXPDO={d.PDOS}",
        "LSS_Supported=1",
        "CompactPDO=0",
        "",
    ]


def _dummies() -> list[str]:
    usage = [f"Dummy{code:04X}={int(code in _DUMMIES)}" for code in range(1, 8)]
    return ["[DummyUsage]", *usage, ""]


def _comments() -> list[str]:
    """The units: object, factor and unit, with nothing that a reader of INI files stumbles over."""
    texts = ["Units: value times factor is in the unit. Lines are object, factor, unit"]
    for each in d.ENTRIES.values():
        if each.unit.symbol:
            texts.append(f"0x{each.index:04X}:{each.sub} {each.unit.factor:g} {each.unit.symbol}")
    lines = [f"Line{number}={text}" for number, text in enumerate(texts, 1)]
    return ["[Comments]", f"Lines={len(lines)}", *lines, ""]


def _lists() -> list[str]:
    indices = [each.index for each in d.OBJECTS]
    groups = {
        "MandatoryObjects": [i for i in indices if i in _MANDATORY],
        "OptionalObjects": [i for i in indices if i not in _MANDATORY and not 0x2000 <= i < 0x6000],
        "ManufacturerObjects": [i for i in indices if 0x2000 <= i < 0x6000],
    }
    lines = []
    for name, group in groups.items():
        lines += [f"[{name}]", f"SupportedObjects={len(group)}"]
        lines += [f"{number}=0x{index:04X}" for number, index in enumerate(group, 1)]
        lines += [""]
    return lines


def _sections() -> list[str]:
    lines = []
    for each in d.OBJECTS:
        if each.kind == e.VARIABLE:
            lines += _variable(f"{each.index:04X}", each.entries[0])
            continue
        lines += [
            f"[{each.index:04X}]",
            f"ParameterName={each.name}",
            f"ObjectType=0x{each.kind:X}",
            f"SubNumber={len(each.entries)}",
            "",
        ]
        for entry in each.entries:
            lines += _variable(f"{each.index:04X}sub{entry.sub:X}", entry)
    return lines


def _variable(section: str, entry: e.Entry) -> list[str]:
    lines = [
        f"[{section}]",
        f"ParameterName={entry.name}",
        f"ObjectType=0x{e.VARIABLE:X}",
        f"DataType=0x{entry.type.code:04X}",
        f"AccessType={_access(entry)}",
        f"PDOMapping={int(bool(entry.mappable))}",
    ]
    if entry.type != e.DOMAIN:
        lines += [f"DefaultValue={_default(entry)}"]
    if (entry.low, entry.high) != (entry.type.low, entry.type.high):
        lines += [f"LowLimit={entry.low}", f"HighLimit={entry.high}"]
    return [*lines, ""]


def _access(entry: e.Entry) -> str:
    """CiA 306 gives the direction of a mappable object by its access."""
    if entry.access == e.READ_WRITE and entry.mappable == e.RPDO:
        return "rww"
    return str(entry.access)


def _default(entry: e.Entry) -> str:
    if entry.from_node:
        return f"$NODEID+0x{entry.default:08X}"
    if entry.type == e.U32 and not entry.unit.symbol:
        return f"0x{entry.default:08X}"
    return str(entry.default)
