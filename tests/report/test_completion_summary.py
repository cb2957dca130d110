"""summary.json and model.toml of completed models."""

import json

import pytest
from completion_problems import identified

from bayesid.files.writing import read_json
from bayesid.report.folders import save_identification
from bayesid.report.report_data import report_data
from bayesid.report.summary import EffectSummary, Summary, as_json

HIDDEN = ("stribeck_friction", "delay")


@pytest.fixture(scope="module", params=HIDDEN)
def case(request, tmp_path_factory):
    """What was found of a log, and the folder of it."""
    result = identified(request.param)
    place = tmp_path_factory.mktemp("kept") / "result"
    return result, save_identification(result, place, report=False)


def written(folder):
    return json.loads((folder / "summary.json").read_text())["complete"]


def test_summary_holds_what_entered(case):
    result, folder = case
    complete = written(folder)
    model_selection = result.model_selection
    assert set(complete) == {"effects", "held_back_error", "uncertain", "may_enter", "too_narrow"}
    for name in ("before", "after", "effort"):
        assert complete["held_back_error"][name] == getattr(model_selection, name).tolist()
    assert complete["uncertain"] == list(model_selection.uncertain)
    assert complete["too_narrow"] == json.loads(json.dumps([vars(one) for one in model_selection.too_narrow]))
    assert len(complete["effects"]) == len(model_selection.effects)
    for entry, entered in zip(complete["effects"], model_selection.effects, strict=True):
        assert entry["effect"] == entered.effect
        assert entry["form"] == entered.source.name
        assert entry["joints"] == list(entered.joints)
        assert entry["log10_bayes_factor"] == entered.log10_bayes_factor
        assert entry["equivalent"] == list(entered.equivalent)
        assert all(set(number) == {"value", "sd", "unit"} for number in entry["parameters"].values())


def test_numbers_are_those_of_the_model():
    """Of a term its parameters and what was chosen of its shape; of a delay of the whole robot one number."""
    result = identified("stribeck_friction")
    (entry,) = as_json(report_data(result).summary)["complete"]["effects"]
    assert list(entry["parameters"]) == ["Fk2", "Fs2", "speed2"]
    names = [parameter.name for parameter in result.model.parameters]
    for name in ("Fk2", "Fs2"):
        place, number = names.index(name), entry["parameters"][name]
        assert number["value"] == result.theta[place]
        assert number["sd"] in (None, result.parameter_sd[0][place])
        assert number["unit"] == "N m"
    speed = result.model_selection.effects[0].source.speed[0]
    assert entry["parameters"]["speed2"] == {"value": speed, "sd": None, "unit": "rad/s"}
    late = identified("delay")
    (entry,) = as_json(report_data(late).summary)["complete"]["effects"]
    (entered,) = late.model_selection.effects
    expected = {"value": entered.source.lag[0], "sd": entered.number_sd[0], "unit": "s"}
    assert list(entry["parameters"].values()) == [expected]


def test_summaries_come_back(case):
    result, folder = case
    summary = report_data(result).summary
    back = read_json(folder / "summary.json", Summary, "again")
    assert back == summary
    assert all(isinstance(effect, EffectSummary) for effect in back.complete.effects)
