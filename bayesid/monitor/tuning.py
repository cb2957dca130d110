"""Chosen constants: tracking of a stream, alarms, and memory."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Constants of this package; `TUNING` holds those in use.

    `python -m bayesid.studies.ablation monitor` halves and doubles each of them. If `span`, `wider`, `lasting`,
    `reached` or `often` is doubled, an alarm of a simulated stream names another joint. Other sensitive constants are
    marked below; without a mark or a reason the value is chosen, not measured.
    """

    # Samples and motion
    span: float = 0.12
    """s, window from which the motion is estimated. A longer one assigns torques to wrong joints, a shorter one is
    noisy."""
    fewest_periods: float = 10.0
    """Least length of the window, in periods: enough samples to estimate the noise."""
    spare: int = 2
    """Least number of samples beyond the coefficients of the polynomial, so that it averages noise."""
    memory: float = 1.0
    """s, time constant of the mean squared residual of the fit; longer means follow changes of the noise later."""
    most_in_window: int = 400
    """Most samples of the window, to limit memory and time: 0.2 s at 2 kHz."""
    gap: float = 5.0
    """Periods without a sample after which the state is reset, as friction may have changed its direction."""
    set_back: int = 5
    """Successive late samples with increasing times that are a clock reset: as many as periods of a gap."""
    fastest: float = 2e4
    """Hz, highest accepted rate. No controller logs faster; a rate in mHz is refused."""
    farthest: float = 3.0
    """Largest ratio of a tracker's rate to that of a log's rows; above 5 every row follows a gap."""
    columns_rate: float = 20.0
    """Hz, rate at which the columns of the model are evaluated; they take as long as the other parts of an update."""
    remembered: float = 20.0
    """s, length of stream that is kept: that of a short log for identification."""
    most_remembered: int = 20_000
    """Most rows kept, to limit memory: the last 2 s at 10 kHz."""

    # The model near standstill
    slow: float = 5.0
    """Speed at which dry friction is evaluated, over that of standstill; it is then saturated (tanh 5 = 1 - 1e-4)."""
    near_rest: float = 4.0
    """Speed below which the direction of friction is uncertain, over that of standstill. Larger values raise the
    threshold of contacts at low speed."""
    trust: float = 0.9
    """Factor on P(sign = +) - 0.5 of a joint that has changed since its identification."""

    # Contacts
    observer: float = 35.0
    """1/s, gain of the momentum observer (Haddadin et al. use 25 to 100): higher ones are faster and noisier. Measured
    by `bayesid study tracking`."""
    release: float = 0.6
    """Share of the threshold below which a contact ends; the hysteresis avoids repeated contacts."""
    flicker: float = 0.1
    """s, longest interruption of a contact; shorter ones do not make a second alarm."""
    most_alarms: float = 3600.0
    """Highest accepted rate of false alarms per hour: one a second, too many to be useful."""
    timed: int = 100_000
    """Most updates whose computing times are kept."""
    kept_alarms: int = 1000
    """Most alarms kept, to limit memory: a stream may last for weeks."""

    # Changes
    wider: float = 2.0
    """Ratio of the residual's sd after a change, in the tested hypothesis, to that before."""
    other_motion: float = 2.0
    """Ratio of the residual's sd on another motion to that on the log of the identification. Halved or doubled, an
    alarm of a simulated stream names another joint; doubled, also another kind."""
    largest: float = 6.0
    """Standard deviations at which residuals are clipped, so that a single outlier is not a change."""
    lasting: float = 0.6
    """s, least time of motion in which the sum of a change grew: three times a push of 0.2 s."""
    reached: float = 0.6
    """s, least time in which a sum can reach its limit: more than a push of 0.2 s smoothed to twice its length."""
    often: float = 0.4
    """Least share of the motion since the onset in which the sum of a change grew; it excludes pushes."""
    shortest: float = 0.05
    """s, least time per effective sample: model errors change with the motion, not from sample to sample."""
    highest: float = 1.25
    """Upper bound of the sums, over their limit, so that they decrease soon after a change is over."""
    calm: float = 2.0
    """s, time of motion without misfit after which a change is over."""
    again: float = 2.0
    """Ratio of a change's durations at successive classifications."""
    longest: float = 20.0
    """s, duration up to which a change is classified again: that of the stream kept (`remembered`)."""
    explained: float = 0.5
    """Least share of the misfit that a named kind explains: more than half. Halved, no alarm of a simulated stream
    changes."""
    passes: int = 4
    """Least-squares fits of a kind, each with the signs of the previous one; chosen, not measured."""

    # Running identification
    pause: float = 0.5
    """s, pause after which all segments are new, as correlation across it is neglected."""
    clearly: float = 2.0
    """Standard deviations of the noise below which |effort| may be zero, as in `bayesid.signs`."""
    least_doubt: float = 1e-3
    """Least probability of a wrong sign (maximum log-odds), so that strong segments precede weak ones."""
    outliers: int = 3
    """Most samples of a segment that may consist of outliers alone, as noise may have heavy tails."""


TUNING = Tuning()
