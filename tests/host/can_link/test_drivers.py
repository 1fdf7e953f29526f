"""What is missing for an interface is named as what to install."""

from argparse import Namespace

import can
import pytest

from mdms_host.can_link.link import NoBusError, open_bus, remedy


@pytest.mark.parametrize(
    ("interface", "problem", "told"),
    [
        ("gs_usb", "Cannot import module: No module named 'usb'", "'python-can[gs-usb]'"),
        ("neovi", "Please install python-ics", "'python-can[neovi]'"),
        ("pcan", "pcanbasic library not found.", "PEAK's PCANBasic library"),
    ],
)
def test_missing_driver_is_named_with_its_package(monkeypatch, interface, problem, told):
    def fail(_options):
        raise can.CanInterfaceNotImplementedError(problem)

    monkeypatch.setattr("mdms_host.can_link.link.create_bus_from_namespace", fail)
    with pytest.raises(NoBusError) as failure:
        open_bus(Namespace(interface=interface, channel="0"))
    assert f"install {'its driver: pip install ' if 'python' in told else ''}{told}" in str(
        failure.value
    )


@pytest.mark.parametrize(
    ("interface", "problem"),
    [("slcan", "could not open port can0"), (None, "No module named 'usb'"), ("own", "not found")],
)
def test_what_nothing_is_to_be_installed_for_names_no_package(interface, problem):
    assert remedy(interface, problem) is None


@pytest.mark.parametrize("error", [TypeError("no host"), NameError("canOpen"), ImportError("ics")])
def test_interface_that_fails_in_its_own_way_is_no_bus(monkeypatch, error):
    def fail(_options):
        raise error

    monkeypatch.setattr("mdms_host.can_link.link.create_bus_from_namespace", fail)
    with pytest.raises(NoBusError, match="cannot be opened"):
        open_bus(Namespace(interface="kvaser", channel="0"))
