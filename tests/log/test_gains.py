"""Gains as they are stated: exact, uncertain, unknown, from a file."""

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.log.gains import gains_of
from bayesid.log.log import join_logs
from bayesid.log.reading import read_log

T = np.arange(200) / 100.0
Q = np.column_stack([np.sin(T), np.cos(3.0 * T)])
CURRENTS = {"t": T, "q": Q, "i": np.abs(Q)}
TORQUES = {"t": T, "q": Q, "tau": np.abs(Q)}


def test_what_is_typed_is_what_is_meant_and_comes_back():
    for text, value, sd in (
        ("12~20%,16~4", [12.0, 16.0], [0.2, 0.25]),
        ("-12~20%, 10", [-12.0, 10.0], [0.2, 0.0]),
        ("unknown,16~0%", [1.0, 16.0], [np.inf, 0.0]),
        ("unknown", [1.0, 1.0], [np.inf, np.inf]),
    ):
        for gains in (gains_of(text, 2), gains_of(gains_of(text, 2).text, 2)):
            assert gains.value.tolist() == value
            assert gains.sd == pytest.approx(sd)


def test_a_file_has_a_gain_and_its_sd_a_joint(tmp_path):
    path = tmp_path / "gains.csv"
    path.write_text("joint,gain,sd\n1,12,2.4\n2,16,\n")
    assert gains_of(path, 2).sd == pytest.approx([0.2, 0.0])
    path.write_text("gain,sd\n12,20%\nunknown,\n")
    assert gains_of(path, 2).sd.tolist() == [0.2, np.inf]
    for content, says in {
        "gain,sd\n12,2.4\nsixteen,1\n": "gains.csv, line 3: 'sixteen', '1' are not a gain",
        "K\n12\n": "has no columns gain, sd",
    }.items():
        path.write_text(content)
        with pytest.raises(InputError, match=says):
            gains_of(path, 2)


def test_what_is_no_gain_is_refused():
    for text, says in {
        "12~20%": "1 gains for 2 joints",
        "12~20%,x": "is not a list of gains",
        "12~-5%,3": "is uncertain by -5 %",
        "0~20%,3": "a gain is zero or not finite",
        "missing.csv": "missing.csv",
    }.items():
        with pytest.raises(InputError, match=says):
            gains_of(text, 2)


def test_a_log_of_currents_becomes_one_of_efforts_and_keeps_its_gains():
    log = read_log(CURRENTS, gains="12~20%,16")
    np.testing.assert_allclose(log.effort, np.abs(Q) * [12.0, 16.0])
    assert log.gains.text == "12~20%,16"
    assert log.read_with["gains"] == "12~20%,16"
    assert read_log(CURRENTS, gains=[12.0, 16.0]).gains is None
    moved = log.rescaled([2.0, 1.0])
    np.testing.assert_allclose(moved.effort, np.abs(Q) * [24.0, 16.0])
    assert moved.gains.value.tolist() == [24.0, 16.0]


def test_torques_take_uncertain_factors_but_no_exact_gains():
    log = read_log(TORQUES, gains="1.1~20%,1")
    assert log.gains.of_torques
    assert log.gains.unit_of_gain == "N m per N m as logged"
    with pytest.raises(InputError, match="gains are given but the log holds torques"):
        read_log(TORQUES, gains=[1.1, 1.0])


def test_gains_of_an_earlier_result_read_what_they_belong_to():
    of_torques = bayesid.types.Gains([1.1, 0.9], [0.0, 0.0], of_torques=True)
    np.testing.assert_allclose(read_log(TORQUES, gains=of_torques).effort, np.abs(Q) * [1.1, 0.9])
    with pytest.raises(InputError, match="the log holds currents, but the gains are factors on torques"):
        read_log(CURRENTS, gains=of_torques)
    of_currents = bayesid.types.Gains([12.0, 16.0], [0.0, 0.0])
    with pytest.warns(UserWarning, match="holds torques; gains of currents are ignored"):
        assert read_log(TORQUES, gains=of_currents).effort == pytest.approx(np.abs(Q))


def test_logs_with_different_gains_are_not_joined():
    log = read_log(CURRENTS, gains="12~20%,16")
    assert join_logs([log, log]).gains == log.gains
    for other in ("12~10%,16", [12.0, 16.0]):
        with pytest.raises(InputError, match="read both with the same `gains`"):
            join_logs([log, read_log(CURRENTS, gains=other)])
