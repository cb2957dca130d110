"""What a user sees of a long identification: no stage stands at its end while something else is at work."""

import time

import bayesid
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.signs.search.certified import Certified

STANDING = 0.15  # share of the time that finished stages may stand there; 0.5 and more where stages were not announced


def test_no_stage_stands_at_its_end():
    log = bayesid.simulate_log(bayesid.load_robot("kr5"), 6.0, 100.0, 0.05, (), seed=3)[1].rectified()
    seen = []
    progress = Progress(lambda stage, done, total: seen.append((time.perf_counter(), stage, done, total)))
    sampling = Sampling(budget=4.0, walkers=8)
    identify("kr5", log, search=Certified(budget=1.0), posterior=sampling, complete="off", progress=progress)
    ends = [*(at for at, *_ in seen[1:]), time.perf_counter()]
    lasting = [(end - at, stage, done == total) for (at, stage, done, total), end in zip(seen, ends, strict=True)]
    standing = sum(seconds for seconds, _, finished in lasting if finished)
    assert standing < STANDING * sum(seconds for seconds, *_ in lasting), sorted(lasting)[-5:]
    stages = list(dict.fromkeys(stage for _, stage, *_ in seen))
    expected = ["prepare", "search, round 1", "proof", "fit", "modes", "warm-up", "posterior", "other readings"]
    assert [stage for stage in stages if stage in expected] == expected
