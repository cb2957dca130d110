"""What symbols of parameters and effects mean, in words."""

from types import SimpleNamespace

from bayesid.report.summary import EffectSummary
from bayesid.report.tables import effect_rows, effect_symbols, gain_rows
from bayesid.report.words import meaning, sizes_in_words


def test_a_symbol_is_explained_by_the_effect_that_owns_it():
    known = {
        "J2xy": "inertia xy of link 2",
        "mc10z": "first moment z of link 10",
        "m3": "mass of link 3",
        "Fe12": "saturating viscous friction, joint 12",
        "ks1_2": "balancing spring, joint 2",
        "mpcarried": "",
        "offset": "",
    }
    assert {name: meaning(name).replace(" with a free length", "") for name in known} == known
    assert sizes_in_words("viscous_friction.saturating") == "viscous friction that saturates: [Fe] beyond [knee]"
    assert sizes_in_words("delay") == "efforts lag [lag] behind the motion"
    assert sizes_in_words("of a package that is not installed") == ""


def test_each_form_of_the_effects_is_explained_once():
    forms = ["delay", "viscous_friction.saturating", "viscous_friction.saturating"]
    effects = [SimpleNamespace(form=form, parameters={}) for form in forms]
    summary = SimpleNamespace(complete=SimpleNamespace(effects=effects))
    assert effect_symbols(summary).count("[Fe]") == 1
    assert effect_symbols(SimpleNamespace(complete=None)) == ""


def test_sizes_have_a_readers_units_and_fixed_numbers_are_marked():
    friction = EffectSummary(
        "load_dependent_friction", "load_dependent_friction", (2,), 9.0, (), {"Fl2": number(0.062, 0.0024, "1")}
    )
    saturating = EffectSummary(
        "viscous_friction",
        "viscous_friction.saturating",
        (1,),
        9.0,
        (),
        {"Fe1": number(14.32, 0.58, "N m"), "knee1": number(0.6459, None, "rad/s")},
    )
    delay = EffectSummary("delay", "delay", (), 9.0, (), {"lag": number(0.015, 0.0004, "s")})
    summary = SimpleNamespace(complete=SimpleNamespace(effects=[friction, saturating, delay]))
    assert [row[2] for row in effect_rows(summary)] == [
        "Fl2 6.20 +- 0.24 %",
        "Fe1 14.3 +- 0.6 N m; knee1 0.646 rad/s (fixed)",
        "lag 15.0 +- 0.4 ms",
    ]
    assert "fixed" in effect_symbols(summary)


def number(value, sd, unit):
    return {"value": value, "sd": sd, "unit": unit}


def test_a_gain_known_to_a_factor_has_no_symmetric_deviation():
    gains = SimpleNamespace(
        stated="unknown,12", mean=(3.2, 12.0), sd=(4.4, 0.6), lower=(0.2, 11.0), upper=(45.0, 13.0), ratio_sd=(0.1, 0.1)
    )
    gains.unit, gains.decided_by = "N m/A", ("data", "data")
    sizes = [row[2] for row in gain_rows(SimpleNamespace(gains=gains))]
    assert sizes == ["3.2 N m/A, to a factor of 4", "12.0 +- 0.6 N m/A"]
