"""Which package a CAN interface of python-can needs besides python-can itself."""

from collections.abc import Mapping

#: The extra of python-can that brings an interface's driver.
_EXTRAS: Mapping[str, str] = {
    "canalystii": "canalystii",
    "cantact": "cantact",
    "gs_usb": "gs-usb",
    "neovi": "neovi",
    "nixnet": "nixnet",
    "pcan": "pcan",
    "robotell": "serial",
    "seeedstudio": "seeedstudio",
    "serial": "serial",
    "slcan": "serial",
    "udp_multicast": "multicast",
    "usb2can": "pywin32",
}
#: How python-can and its plug-ins report that a module or a library is not there.
_MISSING = (
    "No module named",
    "not installed",
    "Please install",
    "not found",
    "could not be loaded",
)
#: The makers' own libraries, which no package brings.
_LIBRARIES: Mapping[str, str] = {
    "kvaser": "Kvaser's CANlib",
    "pcan": "PEAK's PCANBasic library",
    "vector": "Vector's XL driver library",
}


def remedy(interface: str | None, problem: str) -> str | None:
    """What to install so that the interface works; None if nothing is missing, or it is unknown."""
    if interface is None or not any(text in problem for text in _MISSING):
        return None
    if interface in _LIBRARIES:
        return f"install {_LIBRARIES[interface]}"
    if interface in _EXTRAS:
        return f"install its driver: pip install 'python-can[{_EXTRAS[interface]}]'"
    return None
