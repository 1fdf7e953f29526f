"""The settings of one cell: written, and verified with all that it has stored."""

from collections.abc import Iterator

from mdms_host.can_link.sdo_client import PATIENT, Read, SdoClient, Setting
from mdms_host.coordination.cell_setup.configuration import SIGNATURE, Configuration
from mdms_host.coordination.cell_setup.steering_settings import PLACES
from mdms_protocol.codecs.frame import Frame


class SetUp:
    """Writes settings, then compares the signature of all stored settings; once a bring-up.

    If it differs, all stored settings are read. Settings that an earlier run of cells that steer
    left behind are set back. `verified` is whether all settings are as expected. `failure` is why a
    transfer cannot be done, and `mismatch` the other differences. Both are None as long as there is
    nothing.
    """

    def __init__(
        self, node_id: int, settings: tuple[Setting, ...], configuration: Configuration
    ) -> None:
        self.verified = False
        self.mismatch: str | None = None
        self._configuration = configuration
        self._client = SdoClient(node_id, (*settings, SIGNATURE), attempts=PATIENT)
        self._corrected = False

    @property
    def failure(self) -> str | None:
        """See above."""
        return self._client.failure

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any."""
        return self._client.poll(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        self._client.on_response(data)
        if self._client.done and not self.verified:
            self._verify()

    def _verify(self) -> None:
        """Compare the signature; if it differs, read all stored settings."""
        answers = self._client.answers
        values = self._configuration.values
        if self._configuration.accepts(answers[SIGNATURE.index, SIGNATURE.sub]):
            self.verified = True
        elif not answers.keys() >= values.keys():
            self._client.append(Read(*place) for place in values)
        elif not self._corrected and (left := self._left_by_cells()):
            self._corrected = True
            reads = (Read(each.index, each.sub) for each in left)
            self._client.append((*left, *reads, SIGNATURE))
        else:
            self.mismatch = self._configuration.differences(answers) or None
            self.verified = self.mismatch is None

    def _left_by_cells(self) -> list[Setting]:
        """Settings that undo an unfinished run in which cells steered."""
        answers, values = self._client.answers, self._configuration.values
        return [
            Setting(*place, values[place]) for place in PLACES if answers[place] != values[place]
        ]
