"""Numbers that were chosen: how a stream is followed, what raises an alarm, and what is kept of a stream."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Choices of this package, with what each is for; `TUNING` holds those in use.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation monitor`). In a simulated stream an alarm
    names another joint where `span`, `wider`, `lasting`, `reached` or `often` is doubled; what else changed a decision
    says so.
    """

    # Samples and motion
    span: float = 0.12
    """s of the window from which the motion is estimated: a longer one takes torques of one joint for those of
    another, a shorter one is noisy."""
    fewest_periods: float = 10.0
    """Periods that the window spans at least: of fewer samples the noise is not known."""
    spare: int = 2
    """Samples more than the polynomial has coefficients, from which on it is used: it then averages something."""
    memory: float = 1.0
    """s over which the size of the fit's residual is averaged."""
    most_in_window: int = 400
    """Samples of the window, for memory and time: of 0.2 s at 2 kHz."""
    gap: float = 5.0
    """Periods without a sample from which on what was before is forgotten: friction may have turned round meanwhile."""
    set_back: int = 5
    """Late samples in a row whose times go up that tell of a clock that was set back: as many as periods of a gap."""
    fastest: float = 2e4
    """Hz; no controller logs faster: a rate in mHz, or a period in its place, is told."""
    farthest: float = 3.0
    """Factor between a tracker's rate and that of a log's rows: beyond 5 every row comes after a gap."""
    looks: float = 20.0
    """Hz at which the columns of the model are made: they cost as much as all the rest."""
    remembered: float = 20.0
    """s that are remembered: as long as shorter logs from which robots are identified."""
    most_remembered: int = 20_000
    """Rows, for memory: the last 2 s at 10 kHz."""

    # The model near standstill
    slow: float = 5.0
    """Speeds of standstill at which dry friction is looked at: it is then all there (tanh 5 = 1 - 1e-4)."""
    near_rest: float = 4.0
    """Speeds of standstill up to which the direction of friction is in doubt."""
    trust: float = 0.9
    """How far a sign is believed whose joint has changed since its model was identified."""

    # Contacts
    observer: float = 35.0
    """1/s, gain of the momentum observer (Haddadin et al. use 25 to 100); studied by `bayesid study tracking` alone."""
    release: float = 0.6
    """Share of its threshold below which an external torque has ended: it may flicker about it."""
    flicker: float = 0.1
    """s after which a contact that has ended is another one when it comes back."""
    most_alarms: float = 3600.0
    """False alarms an hour: one a second, with which nobody is served."""
    timed: int = 100_000
    """Updates whose times are remembered."""
    kept_alarms: int = 1000
    """Alarms that are remembered: a stream may last for weeks."""

    # Changes
    wider: float = 2.0
    """How many times as wide a residual is that is tested for."""
    other_motion: float = 2.0
    """Residual on another motion over that of the log a model was identified from. Halved or doubled, an alarm
    names another joint in a simulated stream; doubled, another kind too."""
    largest: float = 6.0
    """Standard deviations beyond which a residual says no more: a single outlier is no change."""
    lasting: float = 0.6
    """s of motion in which a change has shown, at least: three times as long as a push."""
    reached: float = 0.6
    """s over which a sum needs to grow to reach its limit, at least."""
    often: float = 0.4
    """Share of the motion since it began in which a change has shown, at least: pushes are none."""
    shortest: float = 0.05
    """s that count as one sample at least: what a model lacks changes with the motion, not from sample to sample."""
    highest: float = 1.25
    """Of the sums, in limits: so that they come down again when a change is over."""
    calm: float = 2.0
    """s of motion without a misfit after which a change is over."""
    again: float = 2.0
    """A change is looked at again when it has lasted so many times as long."""
    longest: float = 20.0
    """s up to which it is looked at again: what is remembered."""
    explained: float = 0.5
    """Share of the misfit that a named kind explains at least. Doubled, no kind explains a misfit; halved, no alarm
    of a simulated stream changes."""
    passes: int = 4
    """Fits of a kind, each with the signs of the one before it."""

    # Running identification
    pause: float = 0.5
    """s; after a longer pause every stretch is a new one: a residual's correlation is not followed beyond."""
    clearly: float = 2.0
    """Standard deviations of the noise within which |effort| may be zero, as in `bayesid.signs`."""
    least_doubt: float = 1e-3
    """No sign is surer than this: strong stretches come before those that are weak and sure."""
    outliers: int = 3
    """Samples up to which a stretch may be outliers alone: noise may have heavy tails."""


TUNING = Tuning()
