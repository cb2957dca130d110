"""How much work the certified search does at each of its steps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Sizes of lists, numbers of trials.

    They decide how long a search takes and how much it can prove, never whether what it proves is true: whatever a
    limit leaves out counts as not excluded. Set by hand on the logs of `studies.real` and on simulated ones
    (`python -m bayesid.studies.benchmarks.search` shows seconds and certificates); none has been studied by itself.

    Attributes:
        candidate_patterns: patterns of each joint among which candidates are looked for.
        candidate_combinations: combinations of all joints that are kept on the way.
        candidate_share: of the energy of a joint's strongest segment, from which on a segment takes part.
        candidates_solved: in the cone, at most.
        candidates_settled: of those.
        turned: single segments of the best candidate that are turned on trial.
        settling_rounds: of settling undecided segments and parameters in turn.
        shares: of the energy of a joint's strongest segment from which its segments are decided, from coarse to fine.
        longest_list: patterns that a joint's list may hold; it decides fewer segments otherwise.
        few_combinations: up to which the finest lists are joined at once.
        most_combinations: that may be held on the way there.
        least_width: patterns that a beam holds that looks for a joint's least cost.
        listed: segments of a joint, the strongest, that patterns decide at most; bounds time and memory.
        least_group: segments of a joint whose least cost is looked for at once; bounds time and memory.
        least_list: patterns that the list may hold that proves it.
        enumerated: segments left by persistency of which all sets of flips are tried (2^14 of them).
        many_flips: segments beyond which their interference is bounded without looking at pairs.
        charged_flips: segments up to which charges are handed on between them.
        sweeps: how often they are.
        rows_at_once: of K that are made together; bounds the memory.
        pairs_at_once: of patterns that are priced together when two lists are joined; bounds the memory.
        allowance: cost beyond that of a single assignment of the allowed mass up to which a proof goes at first.
        unmoved: share of the budget after which a proof is given up whose lower bound is still zero, for the sake of
            the other ways. Proofs that end do so within a third of the default budget on all logs of `real_floor`.
        growth: cost beyond what would have sufficed before, by which a proof is widened.
    """

    candidate_patterns: int = 64
    candidate_combinations: int = 256
    candidate_share: float = 0.02
    candidates_solved: int = 64
    candidates_settled: int = 3
    turned: int = 20
    settling_rounds: int = 20
    shares: tuple[float, ...] = (0.7, 0.4, 0.2, 0.1)
    longest_list: int = 20_000
    few_combinations: int = 2_500
    most_combinations: int = 50_000
    least_width: int = 64
    listed: int = 300
    least_group: int = 500
    least_list: int = 2_000
    enumerated: int = 14
    many_flips: int = 8_000
    charged_flips: int = 400
    sweeps: int = 4
    rows_at_once: int = 1_000
    pairs_at_once: int = 50_000
    allowance: float = 10.0
    growth: float = 2.0
    unmoved: float = 1.0 / 3.0
