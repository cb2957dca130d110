"""The mutation check: its packages exist, and a change alters one expression."""

from pathlib import Path

from bayesid.studies.mutations import PACKAGES, mutations_of

ROOT = Path(__file__).parents[2]


def test_every_package_has_source_and_tests():
    assert [name for name in PACKAGES for part in ("bayesid", "tests") if not (ROOT / part / name).is_dir()] == []


def test_each_kind_of_change():
    source = "def f(x, y):\n    return 2.0 * x[0] if x[1] - y < 3 else -y\n"
    changed = {
        mutation.kind: mutation.applied(source).splitlines()[1].strip() for mutation in mutations_of(source, "f")
    }
    assert changed == {
        "comparison": "return 2.0 * x[0] if (x[1] - y > 3) else -y",
        "factor": "return (4.0) * x[0] if x[1] - y < 3 else -y",
        "index": "return 2.0 * (x[1]) if x[1] - y < 3 else -y",
        "sign": "return 2.0 * x[0] if x[1] - y < 3 else (y)",
    }
