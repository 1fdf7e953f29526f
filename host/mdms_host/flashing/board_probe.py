"""What a board runs at its prompt to answer questions about itself, in MicroPython."""

from textwrap import dedent

from mdms_host.flashing.board_link import BoardLink

_PROBE = dedent("""\
    import os, sys
    _root = "/flash" if "flash" in os.listdir("/") else os.getcwd()

    def _who():
        try:
            import machine
            chip = machine.unique_id()
        except (ImportError, AttributeError):
            chip = b""
        told = sys.implementation
        return told._machine, tuple(told.version[:3]), told._mpy, chip, _root, os.getcwd()

    def _version(path):
        before = sys.path[:]
        sys.path[:] = path
        try:
            from mdms_protocol.version import VERSION
            return VERSION
        except ImportError:
            return None
        except Exception:
            return ""
        finally:
            sys.path[:] = before
            for name in ("mdms_protocol.version", "mdms_protocol"):
                sys.modules.pop(name, None)

    def _rom():
        try:
            import vfs
        except ImportError:
            return None
        if not hasattr(vfs, "rom_ioctl") or vfs.rom_ioctl(1) < 1:
            return None
        found = vfs.rom_ioctl(2, 0)
        return None if isinstance(found, int) else found

    def _rom_size():
        rom = _rom()
        if rom is None:
            return 0
        return rom.ioctl(4, 0) * rom.ioctl(5, 0) if hasattr(rom, "ioctl") else len(rom)

    def _rom_names():
        try:
            return os.listdir("/rom")
        except (OSError, ValueError):  # none, or a name that was cut while it was written
            return []

    def _rom_hash(size):
        import hashlib
        return hashlib.sha256(memoryview(_rom())[:size]).digest()

    def _files(at, found):
        for each in os.ilistdir(_root + at):
            path = at + "/" + each[0]
            if each[1] & 0x4000:
                _files(path, found)
            else:
                found.append(path[1:])
        return found

    def _remove(path):
        os.remove(_root + "/" + path)
        while "/" in path:
            path = path.rsplit("/", 1)[0]
            try:
                os.rmdir(_root + "/" + path)
            except OSError:
                return

    def _make_folders(path):
        at = _root
        for name in path.split("/")[:-1]:
            at += "/" + name
            try:
                os.mkdir(at)
            except OSError:
                pass

    def _hashes(paths):
        import hashlib
        each, buffer = [], memoryview(bytearray(512))
        for path in paths:
            one = hashlib.sha256()
            with open(_root + "/" + path, "rb") as file:
                count = file.readinto(buffer)
                while count:
                    one.update(buffer[:count])
                    count = file.readinto(buffer)
            _feed()
            each.append(one.digest())
        return each
    """)


def teach(link: BoardLink) -> None:
    """Define on the board what it is asked for after this; a reset takes it away."""
    link.run(_PROBE)
