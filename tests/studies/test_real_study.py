"""The report of the study of real logs has every column of its rows."""

from bayesid.effects import STANDARD
from bayesid.studies.real import POOR, STUDY
from tests.studies.reported import reported


def row(log, terms, motion):
    """Scores of a log with two joints."""
    names = ("all", "smooth", "velocity", "smooth_truth", "sure", "every_sure", "rest_right", "rest_confidence", "auc")
    shares = dict.fromkeys(names, 0.9)
    counts = dict.fromkeys(("segments", "wrong_segments", "wrong_moving", "at_rest", "min_ess"), 7)
    joints = {name: [0.75, 0.25] for name in ("joints", "velocity_joints", "smooth_truth_joints")}
    rates = {"sure_wrong": 0.01, "every_sure_wrong": 0.02, "auc_moving": 0.6, "max_rhat": 1.0}
    of_log = {"log": log, "terms": list(terms), "predicts": "", "verdict": "look", "why": "two joints"}
    timings = {"search": 1.0, "seconds": 2.0, "posterior": 3.0}
    scores = {"motion": motion, "determined": 0.8125, "certified": True, "timings": timings}
    return {**shares, **counts, **joints, **rates, **of_log, **scores}


def test_the_report_names_the_worst_log_and_its_determined_samples():
    predicted = {name: [0.5, 1.5] for name in ("predicted", "signed", "ratio", "coverage")}
    rows = [row("arm/a", STANDARD, 0.98), row("arm/b", STANDARD, 0.96), row("arm/c", POOR, 0.5)]
    text = reported(STUDY, [*rows, {"log": "arm/a", "predicts": "arm/b", "terms": list(STANDARD), **predicted}])
    assert "81.25%" in text
    assert "2 of 2 logs certified; at least 96.00% of the strong samples in motion have the right sign (arm/b)" in text
