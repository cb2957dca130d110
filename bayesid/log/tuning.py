"""Chosen constants of this package: plausible logs, faults, filters and segments."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi


@dataclass(frozen=True)
class Tuning:
    """Constants without a study or a reason are chosen, not measured.

    `python -m bayesid.studies.ablation log` halves and doubles most of them; those that changed a decision on UR10e's
    log are marked.
    """

    # What a table may hold
    fewest_rows: int = 50
    """Minimum rows, and distinct instants, of a log: 0.5 s at 100 Hz, too short to filter."""
    largest_reading: float = 1e6
    """Readings above this, in SI units, are refused: uninitialised memory gives up to 1e282."""
    longest_gap: float = 3600.0
    """s. A longer gap means two recordings, or a clock that was set."""
    slowest_step: float = 0.5
    """s. A longer typical step is not a time in seconds: controllers log every 1 to 12 ms, slow buses every 0.1 s."""
    unsorted: float = 0.01
    """Share of backward steps above which a time column is out of order, whatever its unit."""
    repeated_times: float = 0.75
    """Share of moving rows that repeat the previous time, above which the clock is too coarse."""
    few_turns: float = 4.0 * pi
    """rad; two turns either way. Few joints exceed it, so positions beyond may be degrees."""
    many_turns: float = 20.0 * pi
    """rad; ten turns either way. Positions beyond it even in degrees have neither unit."""
    strongest_effort: float = 1e5
    """N m; no arm joint is stronger. Robots for payloads of 2 t reach about 5e4."""
    efforts_as_velocities: float = 0.1
    """Relative difference below which efforts are taken to be velocities."""
    most_uncertain_gain: float = 1.0
    """Relative standard deviation beyond which a gain must be given as unknown."""
    held_periods: int = 10
    """A repeated row is kept after this many typical periods; twice as many without a row are a pause."""

    least_effort: float = 1e-9
    """N m; smaller efforts are uninitialised memory, below the resolution of any sensor."""

    # Velocities beside positions
    speed_window: int = 20
    """Rows over which velocities are integrated before they are compared, to average noise."""
    same_motion: float = 0.9
    """Correlation above which two signals show the same motion: real logs have 0.99 and more, other signals 0."""
    another_unit: float = 2.0
    """Ratio of velocity to the derivative of position that shows another unit; common ones differ by 6.3 or more."""
    fastest: float = 60.0
    """rad/s; above the data sheets of all joints (small wrists 10 to 20, delta robots 50)."""
    burst: float = 2.0
    """Velocities are clipped at this multiple of their 98th percentile, against spikes."""
    slow_rows: float = 2.0
    """Rows between changes of a reading, above which it updates more slowly than the log."""
    regular: float = 0.8
    """Minimum share of equal distances between changes; with fewer, the robot only rests at times."""
    stuck: float = 0.01
    """rad. A constant position with a larger integrated velocity is an error: ten times `encoder`."""
    smooth: float = 0.1
    """Median deviation from the mean of the neighbours, over the standard deviation, below which a position is smooth;
    noise alone has 0.8."""
    wrap_slack: float = 1.0
    """rad; tolerance of a wrapped position at one turn, and of its steps: 60 rad/s at 60 Hz."""
    wrap_steps: float = 4.0
    """A step across a wrap may be this multiple of the largest usual step."""
    named_unit: float = 0.03
    """Relative tolerance of a ratio to name its unit."""

    # Files of one run, and logs of one robot
    in_common: float = 0.5
    """Minimum share of the shortest part of a run that all parts cover."""
    same_stamp: float = 0.01
    """Share of a period by which equal stamps may differ through rounding."""
    joined_pause: float = 3.0
    """s; minimum pause between joined logs, longer than any filter reaches (1.5 cut-off periods)."""
    joined_pause_periods: int = 100
    """Minimum pause between joined logs in periods, well above that of a pause."""
    same_rate: float = 0.2
    """Logs whose rates differ by more than this share are not joined."""

    # Text
    header_lines: int = 100
    """Lines searched for the header; recorders write their settings above it."""
    header_bytes: int = 1 << 20
    """Limit in bytes for the header with the first values, and for a line of a stream."""
    longest_label: int = 500
    """Letters; longer labels are not searched for names."""
    longest_stream: int = 1 << 32
    """Bytes kept of a stream: more than a day of seven joints at 500 Hz."""
    most_objects: int = 100_000
    """Maximum number of variables, fields and groups of a binary file; logs have dozens."""

    complete_rows: float = 0.5
    """Minimum share of complete rows for dropping the others; separately sampled topics have none."""

    # Readings that hold a sign in a code
    code_bits: int = 7
    """Minimum bits of a sign code: registers have at least 8, and one bit may be unused."""
    code_joins: float = 0.5
    """Decoding must shrink the jumps between both halves of a scale to this share; for absolute values they grow."""
    code_crossings: int = 3
    """Minimum number of such jumps; one outlier makes two."""
    code_share: float = 0.01
    """Minimum share of readings in each half of a scale; outliers are rarer."""
    count_rounding: float = 0.1
    """Tolerance, in counts, of readings that are rounded multiples of a count."""
    empty_band: float = 0.25
    """Width of an empty band, as a share of a reading's range, that an absolute value never has."""
    band_values: int = 10
    """Minimum distinct readings on each side of an empty band: coarse readings have few, a dead zone one."""
    off_middle: float = 0.1
    """Deviation of the median from the zero of an offset code, over the spread, allowed in the median joint."""
    turning: float = 0.2
    """Share of a joint's range that it must move back and forth to count as a reversal."""
    near_zero: float = 0.05
    """Share of its maximum below which an absolute value must come in most joints; it does in all 18 real logs."""
    offset: float = 1.0
    """Offset over variation of a reading, above which it is not an absolute value; 18 real logs have at most 0.33."""
    least_work: float = 0.15
    """Minimum mean correlation of efforts and velocities that identifies the positive direction: 18 real logs have at
    least 0.16, simulated ones with little friction 0.09 of either sign."""

    # Faults; all are ratios within one channel
    outlier: float = 5.0
    """An effort or velocity this many times all but one of its neighbours is an outlier; nine real logs reach 3.9."""
    outlier_steps: float = 10.0
    """A reading this many neighbouring steps away from both sides is an outlier; nine real logs reach 2."""
    excursion: float = 0.5
    """s. A position that jumps away and back within it is faulty."""
    neighbours: int = 8
    """Runs on each side with which an outlier is compared, so that a second outlier does not matter. Halved, UR10e's
    log gets other segments."""
    weak: float = 0.05
    """Share of a channel's 99th percentile below which outliers are ignored; smaller samples have little weight."""
    slight: float = 1e-3
    """Share of a joint's range below which position jumps are ignored."""
    dropout: float = 0.05
    """s; shortest dropout, as known from transports and drives."""
    dropout_rows: int = 4
    """Minimum rows of a dropout; equal neighbours are common in slow logs."""
    unusual: float = 4.0
    """A dropout is this many times longer than the 95th percentile of the channel's runs."""
    abrupt: float = 4.0
    """Steps of the channel that count as a jump after a dropout, or changes of speed that count as a sudden stop."""
    clearly_moving: float = 0.2
    """Share of a joint's usual top speed above which it cannot stop between two rows."""
    steady: float = 1e-3
    """Relative variation of speed required during a dropout: a noiseless steady motion has a constant effort."""
    past_blind: float = 3.0
    """Multiple of the smallest nonzero reading within which a sensor with a dead zone may fall to zero."""

    velocity_rows: int = 4
    """Rows over which a velocity is integrated for comparison with the change of position."""
    foreign: float = 1.0
    """Share of a joint's top speed by which a velocity may differ from the derivative; some drives filter for 0.5 s."""
    foreign_share: float = 0.2
    """Share of rows above which a deviating velocity is another signal instead of a local fault."""

    # Signals
    filter_order: int = 4
    """Order of the Butterworth filter in each direction, twice that in total; customary in the field."""
    encoder: float = 1e-3
    """rad, or m; a joint that stays within this range shows only encoder noise."""
    slowest_cutoff: float = 5.0
    """Hz; minimum chosen cut-off, as friction has steps faster than any motion. Halved or doubled, UR10e's log gets
    other segments."""
    fewest_cutoff_periods: float = 4.0
    """Minimum cut-off periods in a log; half a period at each end is unused."""
    grid_always: int = 1_000_000
    """Samples that an even grid may always have; they fit the memory of any machine."""
    grid_per_row: int = 20
    """Maximum grid samples per row; emptier grids come from stamps in bursts or pauses of hours."""
    thinned_from: int = 100_000
    """Samples above which a log is thinned after filtering."""
    least_over_cutoff: float = 6.0
    """Minimum rate of a thinned log over the motion's cut-off: three times the efforts' cut-off."""
    evened_rows: int = 51
    """Rows over which jittering time stamps are smoothed: half a second at 100 Hz."""
    smoother: float = 0.25
    """Smoothed stamps are used if they reduce the positions' roughness to this share."""
    filter_memory: float = 3.0
    """Cut-off periods after which a low-pass response has decayed: to e^-13 at orders one and two."""

    # Segments
    slope_jump: float = 0.1
    """Share of the 99th percentile by which the slope of |effort| must jump for a cut. Halved or doubled, UR10e's log
    gets other segments."""
    acceleration_jump: float = 0.5
    """Share of its 99th percentile by which the acceleration must jump for a cut. Halved or doubled, UR10e's log gets
    other segments."""
    zero_ceiling: float = 0.35
    """Share of the 99th percentile of |effort| above which a minimum is not a sign change. Halved or doubled, UR10e's
    log gets other segments."""


TUNING = Tuning()
