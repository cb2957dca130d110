"""Result folders, tampered with: what reads them or reports on them says in one line what is wrong."""

import json
import tomllib
from functools import reduce

import numpy as np
import pytest
import tomli_w
from conftest import small_robot, smooth_motion
from made_findings import make_findings
from mutations import BUDGETS, check_reader, fuzz, mutated_files, mutated_tree

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.files.config import CONFIG
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.model_file import load, model_table
from bayesid.regression.noise import Noise
from bayesid.report.folders import make_report
from bayesid.report.report_data import read_report_data, write_findings
from bayesid.report.summary import as_json

N = 2


def stored_model():
    """Of a robot of two joints with a term that has numbers of its own, and a sensor that distorts."""
    robot, motion = small_robot(N), smooth_motion(N, 4.0, 50.0)
    model = Model(robot, make_terms(STANDARD, robot, motion)).extend(make_effect("delay", {"lag": (0.004,)}))
    rng = np.random.default_rng(3)
    r = len(base_coefficients(model))
    root = rng.standard_normal((r, r))
    noise = Noise(*(np.full(N, value) for value in (0.1, 0.2, 0.05, 3.0)))
    return IdentifiedModel(model, rng.standard_normal(len(model.parameters)), noise, root @ root.T)


READING = (
    'gains = [1.0, 2.0]\ndegrees = true\nunsigned = [1]\ncolumns = {t = "Zeit [ms]", q = "A{}"}\njoints = "a, b"\n'
)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """File to its bytes, of a folder that everything reads."""
    folder = tmp_path_factory.mktemp("sample")
    findings = make_findings(N, validated=True)
    write_findings(findings, folder / "findings.npz")
    (folder / "summary.json").write_text(json.dumps(as_json(findings.summary)), encoding="utf-8")
    stored = stored_model()
    (folder / "model.toml").write_text(tomli_w.dumps(model_table(stored)), encoding="utf-8")
    (folder / CONFIG).write_text(READING, encoding="utf-8")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def folder(sample, tmp_path):
    for name, content in sample.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


@BUDGETS
def test_bytes(folder, sample, examples):
    def reads(named):
        name, content = named
        (folder / name).write_bytes(content)
        reads = [check_reader(lambda: load(folder))] if name != "findings.npz" else []
        reads += [check_reader(lambda: read_report_data(folder))] if name != "model.toml" else []
        (folder / name).write_bytes(sample[name])
        return all(reads)

    assert all(map(reads, sample.items()))
    fuzz(mutated_files({name: ("", content) for name, content in sample.items()}), reads, 3 * examples)


@BUDGETS
def test_tables_of_the_model_and_the_summary(folder, sample, examples):
    def check_model(table):
        try:
            (folder / "model.toml").write_bytes(tomli_w.dumps(table).encode())
        except (TypeError, UnicodeEncodeError, ValueError):  # what TOML cannot hold
            return
        check_reader(lambda: load(folder))

    def check_summary(table):
        (folder / "summary.json").write_text(json.dumps(table), encoding="utf-8")
        check_reader(lambda: read_report_data(folder))

    fuzz(mutated_tree(tomllib.loads(sample["model.toml"].decode())), check_model, examples)
    fuzz(mutated_tree(json.loads(sample["summary.json"])), check_summary, examples)


def test_a_summary_of_something_else(folder):
    path = folder / "summary.json"
    whole = path.read_text(encoding="utf-8")
    for place, key, value, said in (
        ((), "warnings", 3, r"Expected `array`, got `int` - at `\$.warnings`"),
        (("search",), "seconds", "long", r"Expected `float`, got `str` - at `\$.search.seconds`"),
    ):
        content = json.loads(whole)
        reduce(dict.__getitem__, place, content)[key] = value
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            make_report(folder)
    assert not (folder / "report.html").exists()
