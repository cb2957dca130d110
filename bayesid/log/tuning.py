"""Numbers of this package that are choices: what a log may hold, what is a fault, how it is filtered and cut."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi


@dataclass(frozen=True)
class Tuning:
    """Many of them were halved and doubled (`python -m bayesid.studies.ablation log`).

    Where that was seen to change a decision on UR10e's log, the number's sentence says so.
    """

    # What a table may hold
    fewest_rows: int = 50
    """Rows of a log, and distinct instants in it, at least: 0.5 s at 100 Hz, too short to filter."""
    absurd: float = 1e6
    """No robot moves or pushes this much in SI units; logs hold 1e282 from uninitialised memory."""
    longest_gap: float = 3600.0
    """s; a log that pauses longer is two recordings, or its clock was set in between."""
    slowest_step: float = 0.5
    """s; a typical step this long counts something else: controllers log every 1 to 12 ms, a slow bus every 0.1 s."""
    unsorted: float = 0.01
    """Share of steps backwards above which a time is out of order, whatever its unit."""
    stands: float = 0.75
    """Share of rows that move at the time of the row before, above which a clock is too coarse."""
    few_turns: float = 4.0 * pi
    """rad; two turns either way, which few joints leave: positions beyond may be degrees."""
    many_turns: float = 20.0 * pi
    """rad; ten turns either way. Positions beyond even in degrees are in neither unit."""
    strongest_effort: float = 1e5
    """N m; no joint of an arm is as strong: those for payloads of 2 t have some 5e4."""
    efforts_as_velocities: float = 0.1
    """Share by which efforts may differ from velocities that are taken for them."""
    most_uncertain_gain: float = 1.0
    """Relative standard deviation of a gain beyond which it is unknown."""
    held_periods: int = 10
    """A repeated row is kept after so many typical periods without a new one; a log pauses after twice as many."""

    least_effort: float = 1e-9
    """N m; efforts below are memory that nobody has filled: no sensor resolves them."""

    # Velocities beside positions
    speed_window: int = 20
    """Rows over which velocities are summed before they are compared, so that noise counts little."""
    same_motion: float = 0.9
    """Correlation from which on two signals show the same motion: real logs have 0.99 and more, other signals 0."""
    another_unit: float = 2.0
    """Factor between velocities and the change of positions that shows another unit: usual ones differ by 6.3."""
    fastest: float = 60.0
    """rad/s; faster than any joint by its data sheet (wrists of small arms 10 to 20, delta robots 50)."""
    burst: float = 2.0
    """Of its 98th percentile, to which a velocity is cut before it is compared, so that single spikes do not count."""
    slow_rows: float = 2.0
    """Rows between two changes of a reading from which on it is published more slowly than the log is written."""
    regular: float = 0.8
    """Share of such distances that are alike, at least: else the robot rests now and then."""
    stuck: float = 0.01
    """rad that a joint is moved by its velocity while its position stays: ten times what an encoder's noise is."""
    smooth: float = 0.1
    """Of a position's standard deviation, by which it is usually off the middle of its neighbours, at most, so that its
    change is a motion: of noise alone it is 0.8."""
    wrap_slack: float = 1.0
    """rad by which a wrapped position may leave a turn, or step where it is wrapped: 60 rad/s at 60 Hz."""
    wrap_steps: float = 4.0
    """Largest usual steps of a position within which its step is where it was wrapped."""
    named_unit: float = 0.03
    """How far a factor may be from that of a unit to name it."""

    # Files of one run, and logs of one robot
    in_common: float = 0.5
    """Share of the shortest part of a run that all parts have in common, at least."""
    same_stamp: float = 0.01
    """Share of a period by which two stamps of one instant may differ: rounding."""
    joined_pause: float = 3.0
    """s between two logs that are joined, at least: longer than any filter looks ahead (1.5 periods of a cut-off)."""
    joined_pause_periods: int = 100
    """Periods between two logs that are joined, at least: well above those from which on a log pauses."""
    same_rate: float = 0.2
    """Logs whose rates differ by more than this share are not joined."""

    # Text
    header_lines: int = 100
    """Lines in which a header is looked for: recorders write their settings above it."""
    header_bytes: int = 1 << 20
    """Bytes in which the header and the first values are, and of the longest line of a stream: more than any has."""
    longest_label: int = 500
    """Letters of a label that is looked into: no column of a log is called so."""
    longest_stream: int = 1 << 32
    """Bytes of a stream that are kept: more than a day of seven joints at 500 Hz has in text."""
    most_objects: int = 100_000
    """Variables, fields and groups of a binary file; logs have dozens."""

    complete_rows: float = 0.5
    """Share of the rows with any value that are complete, at least, to do without the others; topics that were sampled
    apart have none."""

    # Readings that hold a sign in a code
    code_bits: int = 7
    """Bits of a code, at least: a register has 8 or more, and half of one more of a scale is in use."""
    code_joins: float = 0.5
    """Share to which decoding must shrink the jumps between both halves of a scale: an absolute value's grow."""
    code_crossings: int = 3
    """Such jumps, at least: an outlier makes two."""
    code_share: float = 0.01
    """Share of readings in either half of a scale, at least: outliers are rarer."""
    count_rounding: float = 0.1
    """Of a count, by which readings that are multiples of one may be off, as they were rounded."""
    empty_band: float = 0.25
    """Share of a reading's range that no absolute value leaves out between others."""
    band_values: int = 10
    """Distinct readings on either side of an empty band: a coarse reading has few, a dead zone one."""
    off_middle: float = 0.1
    """Of what readings vary by, by which their median may be off the zero of an offset code, in the median joint."""
    turning: float = 0.2
    """Of a joint's travel that it must go back and forth to count as turning round."""
    near_zero: float = 0.05
    """Share of its largest reading below which an absolute value comes in most joints: of 18 real logs in each two."""
    offset: float = 1.0
    """Offset of a reading over what varies in it, above which it is no absolute value; 18 real logs have 0.33."""
    least_work: float = 0.15
    """Mean correlation of efforts and velocities, at least, that shows which direction is the positive one: 18 real
    logs have 0.16 and more, simulated ones without much friction 0.09 of either sign."""

    # Faults; all are ratios within one channel
    outlier: float = 5.0
    """An effort or velocity this many times all but one of its neighbours is an outlier; nine real logs have 3.9."""
    outlier_steps: float = 10.0
    """A reading that departs from both sides by so many steps of its neighbours is one; nine real logs have 2."""
    excursion: float = 0.5
    """s; what leaves by a jump and comes back by another within it was no motion."""
    neighbours: int = 8
    """Runs on either side that an outlier is compared with: a median past a second outlier. Halved, UR10e's log gets
    other segments."""
    weak: float = 0.05
    """Share of a channel's 99th percentile below which an outlier does no harm: as for samples whose sign counts."""
    slight: float = 1e-3
    """Share of a joint's range below which a jump of its position does no harm."""
    dropout: float = 0.05
    """s; a shorter run is no dropout: the shortest that transports and drives are known for."""
    dropout_rows: int = 4
    """Rows of a dropout: equal neighbours are no rarity in slow logs."""
    unusual: float = 4.0
    """A dropout lasts this many times what all but a twentieth of a channel's runs last."""
    abrupt: float = 4.0
    """Steps by which a channel catches up after a dropout, or changes of speed by which it stops."""
    clearly_moving: float = 0.2
    """Share of a joint's usual top speed from which on it does not stop between two rows."""
    steady: float = 1e-3
    """Share by which a speed must vary over a dropout: without noise a steady motion needs a constant effort."""
    past_blind: float = 3.0
    """Times the least reading above zero, within which a sensor with a dead zone may fall to zero."""

    velocity_rows: int = 4
    """Rows over which a velocity is summed to be compared with the change of the position."""
    foreign: float = 1.0
    """Of a joint's top speed, by which a velocity may differ from that change: some drives filter it for 0.5 s."""
    foreign_share: float = 0.2
    """Share of rows above which a velocity is no local fault but another signal."""

    # Signals
    filter_order: int = 4
    """Of the Butterworth filter each way; twice that in all. The field's custom."""
    encoder: float = 1e-3
    """rad, or m; a joint that never leaves this range shows its encoder's noise."""
    slowest_cutoff: float = 5.0
    """Hz; no cut-off is chosen below it: friction's steps are faster than any motion. Halved or doubled, UR10e's log
    gets other segments."""
    fewest_cutoff_periods: float = 4.0
    """Periods of the cut-off in a log, at least: half of one at either end is not used."""
    grid_always: int = 1_000_000
    """Samples that an even grid may have whatever the log; they fit any machine."""
    grid_per_row: int = 20
    """Samples a row that a larger grid may have: an emptier one comes of stamps in bursts, or of pauses of hours."""
    thinned_from: int = 100_000
    """Samples from which on a long log is thinned, filtered before."""
    least_over_cutoff: float = 6.0
    """Rate of a thinned log over the motion's cut-off: three times that of the efforts' low-pass."""
    evened_rows: int = 51
    """Rows over which jittering time stamps are evened out: half a second at 100 Hz."""
    smoother: float = 0.25
    """Evened stamps are used where they divide the positions' roughness by four or more."""
    filter_memory: float = 3.0
    """Periods of the cut-off after which a low-pass's response has died out: to e^-13 at orders one and two."""

    # Segments
    slope_jump: float = 0.1
    """Share of the 99th percentile by which the slope of |effort| must jump to be a cut. Halved or doubled, UR10e's log
    gets other segments."""
    acceleration_jump: float = 0.5
    """Share of its 99th percentile by which the acceleration must jump to be a cut. Halved or doubled, UR10e's log gets
    other segments."""
    zero_ceiling: float = 0.35
    """Share of the 99th percentile of |effort| above which no minimum is a zero in disguise. Halved or doubled, UR10e's
    log gets other segments."""


TUNING = Tuning()
