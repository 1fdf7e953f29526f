"""One parcel that its cells steer, as they and the host see it: whether it gets on, and where."""

from collections.abc import Callable
from math import degrees

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Bottom
from mdms_host.motion.by_cells.blocked import Blocked
from mdms_host.motion.by_cells.elsewhere import Elsewhere
from mdms_host.motion.by_cells.followed import Followed
from mdms_host.motion.by_cells.notices import Lasting, cells_text
from mdms_host.motion.by_cells.reports import Reports
from mdms_protocol.neighbours import frames as wire

#: Where cells report a parcel at its goal for so long [s], and the host believes it elsewhere, they
#: are given it anew where the host believes it, so many times at most: as it moves, edges show its
#: place to both.
_APART_S = 0.4
_GIVEN_ANEW = 5


class Observed:
    """Compares the cells' reports of a parcel, by its identity, with the host's belief of it.

    Reports to a person are passed to `note`. `apart` is whether the cells must get the parcel anew:
    for them it has arrived, for the host it has not.
    """

    def __init__(
        self,
        name: str,
        identity: int,
        bottom: Bottom,
        reports: Reports,
        note: Callable[[str], None],
    ) -> None:
        self._name = name
        self._identity = identity
        self._reports = reports
        self._note = note
        self._elsewhere = Elsewhere(bottom)
        self.begin_again()

    def begin_again(self) -> None:
        """It was at rest meanwhile: the times of lasting states begin anew."""
        self._blocked = Blocked()
        self._apart, self._apart_for_long = Lasting(_APART_S), Lasting()
        self._given_anew, self._told = 0, False
        self.apart = False

    def follow(
        self,
        followed: Followed,
        belief: Belief | None,
        *,
        has_program: bool,
        now_s: float,
        step_s: float,
    ) -> bool:
        """Compare its way with its program, which its cells have; whether it stands."""
        if belief is None:
            followed.lose()
            return False
        self.apart = False
        arrived = self._reports.have_arrived(self._identity)
        under = self._reports.under(self._identity).values()
        clear = bool(under) and all(each.hold == wire.HOLD_NONE for each in under)
        stands = followed.see(belief.pose, arrived, has_program and clear, step_s)
        if self._blocked.step(self._reports.held(self._identity), followed.left_m, now_s):
            self._note_blocked()
        if followed.there:
            self._given_anew, self._told = 0, False
        apart = arrived and not followed.there
        if self._apart.step(apart, now_s):
            self.apart = self._given_anew < _GIVEN_ANEW
            self._given_anew += 1
        again = self.apart and self._given_anew > 1
        if (self._apart_for_long.step(apart, now_s) or again) and followed.miss:
            self._contradict(*followed.miss)
        return stands

    def _contradict(self, off_m: float, off_rad: float) -> None:
        """The cells take it for arrived where the host does not; reported once."""
        if not self._told:
            self._note(
                f"the cells report {self._name} at its goal, but it is believed "
                f"{1e3 * off_m:.1f} mm and {degrees(abs(off_rad)):.1f} degrees from it"
            )
        self._told = True

    def is_elsewhere(self, belief: Belief | None, now_s: float) -> bool:
        """Whether its cells are to drop it, for some steer it by another place; once each time."""
        pose = None if belief is None else belief.pose
        theirs = self._reports.poses(self._identity)
        wrong = self._elsewhere.step(pose, theirs, now_s)
        if wrong:
            self._note(
                f"{cells_text(wrong)} have {self._name} elsewhere: its program is sent again"
            )
        return bool(wrong)

    def _note_blocked(self) -> None:
        held = self._blocked.held
        lacked = set().union(*held.values())
        lacks = f" and lack {cells_text(lacked)}" if lacked else ""
        self._note(f"{self._name} is blocked: {cells_text(held)} want the way ahead{lacks}")
