"""What symbols of parameters and effects mean, in words."""

from types import SimpleNamespace

from bayesid.report.tables import effect_symbols, gain_rows
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
    summary = SimpleNamespace(complete=SimpleNamespace(effects=[SimpleNamespace(form=form) for form in forms]))
    assert effect_symbols(summary).count("[Fe]") == 1
    assert effect_symbols(SimpleNamespace(complete=None)) == ""


def test_a_gain_known_to_a_factor_has_no_symmetric_deviation():
    gains = SimpleNamespace(
        stated="unknown,12", mean=(3.2, 12.0), sd=(4.4, 0.6), lower=(0.2, 11.0), upper=(45.0, 13.0), ratio_sd=(0.1, 0.1)
    )
    gains.unit, gains.decided_by = "N m/A", ("data", "data")
    sizes = [row[2] for row in gain_rows(SimpleNamespace(gains=gains))]
    assert sizes == ["3.2 N m/A, to a factor of 4", "12.0 +- 0.6 N m/A"]
