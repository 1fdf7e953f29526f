"""The SDO server (CiA 301, 7.2.4): lets one client read and write the object dictionary."""

from mdms_protocol import sdo


class SdoServer:
    """Answers requests through `respond(data)`."""

    def __init__(self, objects, respond):
        self._objects = objects
        self._respond = respond

    def on_request(self, data):
        """Serve one request; return False if it is none."""
        if len(data) != 8:
            return False
        index = data[1] | data[2] << 8
        sub = data[3]
        try:
            self._respond(self._serve(data, index, sub))
        except sdo.AbortError as refusal:
            self._respond(sdo.abort(index, sub, refusal.code))
        return True

    def _serve(self, data, index, sub):
        command = data[0]
        specifier = command & sdo.SPECIFIER
        if specifier == sdo.UPLOAD:
            return self._upload(index, sub)
        if specifier == sdo.DOWNLOAD and command & sdo.EXPEDITED:
            return self._download(data, index, sub)
        raise sdo.AbortError(sdo.UNKNOWN_COMMAND)

    def _upload(self, index, sub):
        value = self._objects.read(index, sub)
        size = len(value)
        if not 1 <= size <= 4:
            raise sdo.AbortError(sdo.UNSUPPORTED_ACCESS)
        command = sdo.UPLOAD_RESPONSE | (4 - size) << 2 | sdo.EXPEDITED | sdo.SIZE_TOLD
        return bytes((command, index & 0xFF, index >> 8, sub)) + value + bytes(4 - size)

    def _download(self, data, index, sub):
        command = data[0]
        size = 4 - (command >> 2 & 3) if command & sdo.SIZE_TOLD else 4
        self._objects.write(index, sub, data[4 : 4 + size])
        return bytes((sdo.DOWNLOAD_RESPONSE, data[1], data[2], sub, 0, 0, 0, 0))
