"""A set of board images while it is being taken: what it has, what is missing, where to hold the board next.

It is enough when the poses are there and the trial calibration of just these images is good.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np

from leadline.calibration.advice import Advice, advised
from leadline.calibration.board import Board
from leadline.calibration.coverage import Coverage, Stance, coverage_of, guessed_rig, stance_of
from leadline.calibration.trial import FIRST, Trial
from leadline.calibration.views import BoardView, numbered_alike
from leadline.rig import Rig
from leadline.rig_derivatives import Medium


class Guide:
    """given: the rig where it is known. ``coverage`` is up to date after each change; ``views`` have both cameras'
    corners and names of their own. Deterministic, without clock and files."""

    coverage: Coverage

    def __init__(
        self,
        board: Board,
        medium: Medium,
        size: tuple[int, int],
        given: Rig | None = None,
        views: Sequence[BoardView] = (),
    ) -> None:
        self._board, self._medium, self.size, self._given = board, medium, size, given
        self.views = numbered_alike(views, board)
        self._tried: tuple[Trial, tuple[str, ...]] | None = None
        self._refresh()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(view.name for view in self.views)

    def stance(self, view: BoardView) -> Stance | None:
        """None where the corners fit no board."""
        return stance_of(self._rig, view, self._board)

    def useless(self, view: BoardView, stance: Stance) -> str:
        """Why a view would not help; empty where it does."""
        away = [stance.away(other) for other in self.coverage.stances]
        if away and min(away) < 1:
            return f"Like image {int(np.argmin(away)) + 1}, which is saved: move on."
        if self.coverage.complete:  # and yet the calibration may not be good: then whatever is different helps
            return "" if self.judged is not None else "The calibration is tried with these images: a moment …"
        more = coverage_of([*self.views, view], self._board, self._rig, self.size)
        return "" if self.coverage.adds(more, stance) else "Seen well, but nothing that is missing: see what is next."

    def add(self, view: BoardView) -> None:
        self.views.append(view)
        self._refresh()

    def remove(self, names: Collection[str]) -> None:
        self.views = [view for view in self.views if view.name not in names]
        self._refresh()

    # -- the trial calibration ---------------------------------------------------------------------------------------

    @property
    def wants_trial(self) -> bool:
        return len(self.views) >= FIRST and self.judged is None

    def take(self, trial: Trial, names: tuple[str, ...]) -> tuple[str, ...]:
        """A trial of the views of these names; those that do not fit the others are taken out, and returned.

        Where more than a quarter does not fit, nobody knows which is wrong: none is taken out.
        """
        few = len(trial.unfit) <= len(names) // 4
        unfit = tuple(name for name in trial.unfit if name in self.names) if few else ()
        self._tried = trial, names
        if unfit:
            self.views = [view for view in self.views if view.name not in unfit]
        self._refresh()
        return unfit

    @property
    def tried(self) -> Trial | None:
        """The newest trial, of these views or some of them."""
        return self._tried[0] if self._tried else None

    @property
    def judged(self) -> Trial | None:
        """The trial of just these views."""
        return self._tried[0] if self._tried and self._tried[1] == self.names else None

    @property
    def enough(self) -> bool:
        return self.coverage.complete and self.judged is not None and self.judged.good

    @property
    def missing(self) -> tuple[str, ...]:
        if self.coverage.missing:
            return tuple(self.coverage.missing)
        return ("the trial calibration",) if self.judged is None else self.judged.doubts

    @property
    def next(self) -> str:
        """What to do, one sentence."""
        if self.enough:
            return "Enough: these images make a good calibration."
        if self.coverage.complete and self.judged is None:
            return "Trying the calibration …"
        return "Show the board elsewhere, nearer, farther, tilted." if self.advice is None else f"{self.advice.words}."

    @cached_property
    def advice(self) -> Advice | None:
        """Where to hold the board next."""
        return advised(self.coverage, self._rig, self._board, self._medium)

    def _refresh(self) -> None:
        tried = self.tried.rig if self.tried else None
        guess = guessed_rig(self.views, self._board, self.size, self._medium)
        self._rig = self._given or tried or guess
        self.coverage = coverage_of(self.views, self._board, self._rig, self.size)
        self.__dict__.pop("advice", None)
