"""Constraints: what cvxpy says of them against their canonical form, the solver, files, and what is refused."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import random_motion, small_robot

from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.constraints import Constraints
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.regression.constraint_file import read_constraints
from bayesid.regression.solver import ConeLeastSquares
from bayesid.regression.stated import StatedParameters, constraints_of
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS
from bayesid.simulation.parameters import random_parameters

ROOM = 1e-9  # about the edge, in which nobody decides


@pytest.fixture(scope="module")
def model():
    robot = small_robot(3)
    return Model(
        robot, make_terms(["rigid_body", "viscous_friction", "coulomb_friction"], robot, random_motion(3, 200, 1))
    )


TETRAHEDRON = [[-0.2, -0.1, 0.0], [0.3, 0.0, -0.05], [0.0, 0.25, 0.1], [0.05, 0.0, 0.4]]
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.2) for y in (-0.15, 0.1) for z in (0.0, 0.3)])
FORMS = {
    "bound": lambda p: p["m3"] <= 5,
    "ratio": lambda p: p["m3"] <= 0.7 * p["m2"],
    "total": lambda p: [p.total_mass >= 7, p.total_mass <= 31.5],
    "box": lambda p: p.com_in_box(2, [-0.1, -0.05, 0.0], [0.1, 0.2, 0.35]),
    "hull": lambda p: p.com_in_hull(2, TETRAHEDRON),
    "corners": lambda p: p.com_in_hull(1, CORNERS),
    "ellipsoid": lambda p: p.density_in_ellipsoid(2, [0.05, 0, 0.1], [0.2, 0.3, 0.4]),
    "norm": lambda p: cp.norm(p.first_moment(2)) <= 0.2 * p["m2"],
    "norm of two": lambda p: cp.norm(cp.hstack([p["mc1x"], p["mc1z"] - 0.2])) <= 0.4,
    "cone": lambda p: cp.SOC(0.1 * p["m1"], p.first_moment(1)),
    "abs": lambda p: cp.abs(p["m1"] - 2 * p["m2"]) <= 3,
    "sum of abs": lambda p: cp.norm1(p.first_moment(2)) <= 0.2 * p.mass(2),
    "max": lambda p: cp.max(cp.hstack([p.mass(1), p.mass(2), p.mass(3)])) <= 6,
    "largest of norms": lambda p: cp.maximum(cp.norm(p.first_moment(1)), p["m2"] - 1) <= p["m1"],
    "sum of largest": lambda p: cp.sum_largest(cp.hstack([p.mass(1), p.mass(2), p.mass(3)]), 2) <= 9,
    "eigenvalue": lambda p: cp.lambda_min(p.pseudo_inertia(2)) >= 0.01,
    "inertia": lambda p: p.inertia(2) - 0.02 * np.eye(3) >> 0,
    "matrix of two": lambda p: cp.bmat([[p["J1xx"], p["J1xy"]], [p["J1xy"], p["J1yy"]]]) >> 0,
    "square": lambda p: cp.square(p["mc2x"]) <= 0.3 * p["m2"],
    "norm of four": lambda p: cp.norm(cp.hstack([p.first_moment(2), p["Fv1"] - p["m3"]])) <= 0.3 * p["m1"],
    "root": lambda p: cp.sqrt(p["m3"]) >= 1.7,
    "root of a difference": lambda p: cp.sqrt(2 * p["m3"] - p["m1"] + 0.3) >= 0.4,
    "root that may be zero": lambda p: cp.sqrt(p["m3"] - p["m2"]) >= -0.2,
    "mean": lambda p: cp.geo_mean(cp.hstack([p["m2"], p["m3"]])) >= 2.5,
    "inverse": lambda p: cp.inv_pos(p["m2"]) <= 0.02 * p["m1"],
    "three squares": lambda p: cp.sum_squares(p.first_moment(2)) <= 0.2 * p["m2"],
    "four squares": lambda p: cp.sum_squares(cp.hstack([p.first_moment(2), p["Fv1"]])) <= 40,
    "squares and more": lambda p: cp.sum_squares(p.first_moment(2) - 0.1) + p["m3"] <= 3,
    "form": lambda p: cp.quad_form(p.first_moment(2), np.array([[2, 0.5, 0], [0.5, 1, 0], [0, 0, 3]])) <= 0.4,
    "over": lambda p: cp.quad_over_lin(p.first_moment(2), p["m2"]) <= 0.9 * p["J2xx"],
    "sum of squares": lambda p: 2 * cp.square(p["mc2x"]) + cp.square(p["mc3y"] - 0.1) + cp.square(p["Fv1"]) <= 30,
    "sum of quotients": lambda p: (
        cp.quad_over_lin(p["mc2x"], p["m2"]) + 0.5 * cp.quad_over_lin(cp.hstack([p["mc3x"], p["mc3y"]]), p["m3"])
        <= 0.1 * p["m1"]
    ),
    "inverse inertia": lambda p: cp.matrix_frac(p.first_moment(2), p.inertia(2)) <= 1.2 * p["m2"],
    "two norms": lambda p: (
        cp.norm(cp.hstack([p["mc2x"], p["mc2z"] - 0.1])) + 2 * cp.norm(cp.hstack([p["mc3y"], p["mc3z"]]))
        <= 0.1 * p["m2"]
    ),
    "norm and size": lambda p: cp.norm(p.first_moment(2)) + 0.5 * cp.abs(p["mc3x"]) <= 0.3 * p["m2"],
}
EQUALITIES = {
    "value": lambda p: p["m3"] == 2.5,
    "coefficient": lambda p: [p["Fc1"] == 1.75, p["Fv2"] == 3 * p["Fv3"]],
    "proportion": lambda p: [p["m2"] == 2 * p["m3"], 3 * p["m3"] + p["Fv1"] == 7, *p.com_in_box(2, [0] * 3, [0.1] * 3)],
    "centre": lambda p: [p.first_moment(2) == 0.1 * p.mass(2), p["m2"] <= 4],
}


def said(form, model):
    p = StatedParameters([one.name for one in model.parameters], model.robot.n_joints)
    stated = (FORMS | EQUALITIES)[form](p)
    return p, stated if isinstance(stated, list) else [stated]


def holds(p, stated, names, theta):
    """(violation) by cvxpy itself, and whether the point is too near the edge to say."""
    for name, value in zip(names, theta, strict=True):
        if name in p.variables:
            p.variables[name].value = value
    with np.errstate(invalid="ignore"):  # a root of what is negative
        violations = [np.max(np.atleast_1d(one.violation())) for one in stated]
    return np.nan_to_num(max(violations), nan=np.inf)


@pytest.mark.parametrize("form", FORMS)
def test_canonical_form_holds_where_cvxpy_says_so(form, model):
    names = [one.name for one in model.parameters]
    canonical = constraints_of(FORMS[form], model)
    p, stated = said(form, model)
    rng, both = np.random.default_rng(4), set()
    for k in range(400):
        theta = random_parameters(model, rng=rng) * rng.uniform(0.2, 4.0) + rng.uniform(
            0.02, 1.0
        ) * rng.standard_normal(len(names)) * (k % 2)
        violation, inside = holds(p, stated, names, theta), canonical.contains(theta, ROOM)
        both.add(inside)
        assert inside == (violation <= 1e-7) or violation < 1e-6, (theta, violation)
    assert both == {True, False}, "points on both sides"


def quadratic(model, seed):
    """Infeasible random data: cone and constraints bind."""
    coefficients, rng = base_coefficients(model), np.random.default_rng(seed)
    motion = random_motion(3, 200, seed)
    columns = model.columns(motion)[:, :, coefficients.selected].reshape(-1, len(coefficients))
    efforts = columns @ rng.normal(size=len(coefficients)) + 0.3 * rng.normal(size=len(columns))
    return coefficients, columns.T @ columns, columns.T @ efforts, float(efforts @ efforts)


@pytest.mark.parametrize(
    "form",
    ["total", "box", "hull", "ellipsoid", "norm", "eigenvalue", "sum of abs", "three squares", "over", *EQUALITIES],
)
def test_optimum_is_that_of_cvxpy(form, model):
    coefficients, hessian, gradient, energy = quadratic(model, 3)
    constrained = replace(model, constraints=constraints_of((FORMS | EQUALITIES)[form], model))
    solver = ConeLeastSquares(constrained.cone, coefficients, hessian, energy, tolerance=1e-9)
    solution = solver.prepared().solve_precisely(gradient)
    p, stated = said(form, model)
    theta = cp.hstack([p[one.name] for one in model.parameters])
    cone = [theta[model.cone.nonnegative] >= 0]
    for body in model.cone.bodies:
        cone.append(cp.reshape(PSEUDO_INERTIA_BASIS.reshape(10, 16).T @ theta[body], (4, 4), order="C") >> 0)
    root = np.linalg.cholesky(hessian).T
    misfit = cp.sum_squares(root @ (coefficients.projection @ theta) - np.linalg.solve(root.T, gradient))
    pull = solver.tikhonov_weight * cp.sum_squares(theta / solver.scale - solver.typical)
    other = cp.Problem(cp.Minimize(misfit + pull), stated + cone).solve(solver=cp.CLARABEL)
    other -= float(gradient @ np.linalg.solve(hessian, gradient))
    assert solution.cost == pytest.approx(other, abs=1e-6 * energy)
    assert solution.cost - solution.lower_bound < 1e-6 * energy
    assert constrained.cone.contains(solution.theta, 1e-6)
    free = ConeLeastSquares(model.cone, coefficients, hessian, energy).prepared().solve_precisely(gradient)
    assert solution.cost > free.cost + 1e-4 * energy, "the constraint binds"


def test_no_multiplier_proves_more_than_the_optimum_in_a_plane(model):
    coefficients, hessian, gradient, energy = quadratic(model, 3)
    cone = replace(model, constraints=constraints_of(EQUALITIES["proportion"], model)).cone
    solver = ConeLeastSquares(cone, coefficients, hessian, energy)
    best, rng = solver.prepared().solve_precisely(gradient), np.random.default_rng(0)
    assert best.theta[cone.stated.names.index("m2")] == 2.0 * best.theta[cone.stated.names.index("m3")]
    for size in (0.01, 1.0):
        prepared = solver.prepared()
        noise = size * np.abs(best.multipliers).max() * rng.normal(size=(50, len(best.multipliers)))
        bounds = [prepared.bound_of(gradient, best.multipliers + one) for one in noise]
        assert max(bounds) <= best.cost + 1e-9 * energy


def test_equalities_are_known_exactly_and_contain_what_they_should(model):
    stated = constraints_of(lambda p: [EQUALITIES["coefficient"](p), FORMS["box"](p), p["m3"] == 2.5], model)
    names, plane = [one.name for one in model.parameters], stated.plane()
    theta = plane.nearest(random_parameters(model, rng=np.random.default_rng(3)))
    assert (theta[names.index("m3")], theta[names.index("Fc1")]) == (2.5, 1.75)
    assert stated.only([0, 1, 3]).contains(theta)
    theta[names.index("Fv2")] += 1e-6
    assert not stated.only([0, 1, 3]).contains(theta)
    np.testing.assert_allclose(plane.basis.T @ plane.basis, np.eye(len(names) - 3), atol=1e-15)
    again = Constraints.from_table(stated.table).of(names)
    np.testing.assert_array_equal(again.plane().basis, plane.basis)
    np.testing.assert_array_equal(again.plane().origin, plane.origin)
    assert stated.homogeneous.labels == (stated.labels[2],), "nothing equal bears another scale of each joint"
    assert "Fv2 == 3 * Fv3" not in stated.of([name for name in names if name != "Fv3"]).labels


KNOWN = """
total_mass = [7, 31.5]
[link.2]
mass = [1.5, 9]
com_box = [[-0.1, -0.05, 0.0], [0.1, 0.2, 0.35]]
ellipsoid = {centre = [0.05, 0, 0.1], semi_axes = [0.2, 0.3, 0.4]}
[link.3]
hull = "tetrahedron.stl"
[bounds]
m3 = [0.5, 5]
Fc1 = [1.5, 1.5]
"""
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def write_stl(path, *, binary):
    triangles = np.array([[TETRAHEDRON[k] for k in face] for face in FACES], dtype="<f4")
    if binary:
        record = np.zeros(len(triangles), dtype=[("normal", "<3f4"), ("corners", "<9f4"), ("more", "<u2")])
        record["corners"] = triangles.reshape(-1, 9)
        path.write_bytes(b"made by a test".ljust(80) + np.uint32(len(triangles)).tobytes() + record.tobytes())
        return
    lines = ["solid link"]
    for triangle in triangles:
        corners = [f"vertex {x:.6f} {y:.6f} {z:.6f}" for x, y, z in triangle]
        lines += ["facet normal 0 0 0", "outer loop", *corners, "endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid link"]))


@pytest.mark.parametrize("binary", [True, False])
def test_file_and_python_state_the_same(tmp_path, model, binary):
    write_stl(tmp_path / "tetrahedron.stl", binary=binary)
    (tmp_path / "known.toml").write_text(KNOWN)
    of_file = constraints_of(read_constraints(tmp_path / "known.toml"), model)

    def python(p):
        yield [p.total_mass >= 7, p.total_mass <= 31.5]
        yield [p.mass(2) >= 1.5, p["m2"] <= 9]
        yield p.com_in_box(2, [-0.1, -0.05, 0.0], [0.1, 0.2, 0.35])
        yield p.density_in_ellipsoid(2, [0.05, 0, 0.1], [0.2, 0.3, 0.4])
        yield p.com_in_hull(3, TETRAHEDRON)
        yield [p["m3"] >= 0.5, p["m3"] <= 5]
        yield p["Fc1"] == 1.5

    in_python = constraints_of(python, model)
    key = np.column_stack([of_file.rows, of_file.offset]), np.column_stack([in_python.rows, in_python.offset])
    first, second = (one[np.lexsort(one.round(5).T)] for one in key)
    np.testing.assert_allclose(first, second, atol=1e-6)
    np.testing.assert_array_equal(of_file.equal, in_python.equal)
    assert of_file.value.tolist() == in_python.value.tolist() == [1.5]
    assert of_file.labels == (
        "total_mass", "link.2.mass", "link.2.com_box", "link.2.ellipsoid", "link.3.hull", "bounds.m3", "bounds.Fc1"
    )  # fmt: skip
    assert in_python.labels[:3] == ("7 <= total_mass", "total_mass <= 31.5", "1.5 <= m2")


def test_tables_and_models_keep_constraints(model):
    stated = constraints_of(lambda p: [FORMS["norm"](p), FORMS["box"](p), FORMS["bound"](p)], model)
    again = Constraints.from_table(stated.table)
    names = [one.name for one in model.parameters]
    theta = random_parameters(model, rng=np.random.default_rng(2))
    np.testing.assert_allclose(again.of(names).slack(theta), stated.slack(theta))
    np.testing.assert_allclose(again.of(names).matrices(theta), stated.matrices(theta))
    fewer = replace(model, constraints=stated, terms=model.terms[:1])
    assert fewer.cone.stated.labels == stated.labels
    assert fewer.cone.size == 30
    assert stated.homogeneous.labels == stated.labels[:2], "a bound is no cone"
    assert stated.without("m3 <= 5").labels == stated.labels[:2]
    assert stated.of(["m3", "Fv1"]).labels == ("m3 <= 5",)


REFUSED = {
    "product": (lambda p: p["m3"] * p["m2"] <= 5, "convex"),
    "concave": (lambda p: cp.norm(p.first_moment(1)) >= 0.1, "convex"),
    "two norms": (lambda p: cp.norm(p.first_moment(1)) + cp.norm(p.first_moment(2)) <= 1, "sum of norms of more than"),
    "squares": (lambda p: cp.sum_squares(p.first_moment(1)) + cp.square(p["m2"]) <= p["m1"], "adds squares of more"),
    "exponential": (lambda p: cp.exp(p["m1"]) <= 5, "exponential"),
    "determinant": (lambda p: cp.log_det(p.pseudo_inertia(1)) >= -3, "exponential"),
    "root": (lambda p: cp.sqrt(p["m3"]) >= p["mc1x"], "mc1x <= sqrt(m3): bounds a root"),
    "root's remedy": (lambda p: cp.sqrt(p["m3"]) >= p["mc1x"], "cp.square(b) <= a"),
    "cube": (lambda p: cp.power(p["m1"], 3) <= 5, "variables other than"),
    "long norm": (lambda p: cp.norm(cp.hstack([p.first_moment(1), p["m3"], p["Fv1"]])) <= p["m2"], "5 numbers"),
    "equality outside": (lambda p: [p["m3"] == 4, p["m2"] <= 3, p["m3"] <= 3.5], "m3 == 4 and m3 <= 3.5 contradict"),
    "equal to two": (lambda p: [p["m2"] == 2 * p["m3"], p["m1"] == 3, p["m2"] == 6, p["m3"] == 4],
                     "m2 == 2 * m3, m2 == 6 and m3 == 4 contradict each other"),
    "no friction": (lambda p: p["Fv1"] == 0, "Fv1 == 0 contradicts positive"),
    "never equal": (lambda p: p["m1"] == p["m1"] + 1, "never holds"),
    "chain": (lambda p: 1 <= p["m1"] <= 5, "by itself"),
    "nothing": (lambda p: [1 <= 5], "True"),
    "other variable": (lambda p: p["m1"] <= cp.Variable(name="x"), "other than those of p"),
    "near name": (lambda p: p["m33"] <= 5, "did you mean m3"),
    "no link": (lambda p: p.mass(4) <= 5, "link from 1 to 3"),
    "flat hull": (lambda p: p.com_in_hull(1, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), "no volume"),
    "box": (lambda p: p.com_in_box(1, [0, 0, 0.1], [0.1, 0.1, 0.1]), "lower corner"),
    "negative mass": (lambda p: p["m2"] <= -1, "m2 <= -1 contradicts positive masses"),
    "clash": (lambda p: [p["m1"] <= 2, p.total_mass >= 9, p["m2"] + p["m3"] <= 5, p["Fv1"] <= 3], "contradict each"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_invalid_constraints_are_refused_by_name(kind, model):
    function, message = REFUSED[kind]
    with pytest.raises(InputError) as caught:
        constraints_of(function, model)
    assert message in str(caught.value)
    if kind == "clash":
        assert all(label in str(caught.value) for label in ("m1 <= 2", "9 <= total_mass", "m2 + m3 <= 5"))
        assert "Fv1" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("total_mas = [1, 2]", "did you mean total_mass"),
        ("[link.2]\ncom_bx = [[0, 0, 0], [1, 1, 1]]", "did you mean com_box"),
        ("[link.2]\ncom_box = [0, 0, 0, 1, 1, 1]", "link.2.com_box"),
        ("[link.2]\nellipsoid = {centre = [0, 0, 0]}", "semi_axes"),
        ("[link.2]\nhull = 'no.stl'", "no.stl is not found"),
        ("[link.9]\nmass = [1, 2]", "no link 9"),
        ("[link.two]\nmass = [1, 2]", "link.two"),
        ("[bounds]\nm3 = [5, 3]", "bounds.m3 = [5, 3] is empty"),
        ("[bounds]\nm3 = 4", "bounds.m3"),
        ("[bounds]\nmm3 = [3, 5]", "did you mean m3"),
        ("", "has no constraints"),
        ("total_mass = [1, nan]", "cannot be used"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(tmp_path, model, text, message):
    (tmp_path / "known.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        constraints_of(read_constraints(tmp_path / "known.toml"), model)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "known.toml" in str(caught.value)


@pytest.fixture(scope="module")
def few_rows(model):
    """Of each of eight arms: the solver in a narrow box and ellipsoid, H and g of 60 rows, and their energy."""
    made = []
    for seed in range(8):
        rng, motion = np.random.default_rng(seed), random_motion(3, 200, seed)
        truth = random_parameters(model, rng=rng)
        mass, coefficients = truth[9:30:10], base_coefficients(model)
        centre = [truth[10 * k + 6 : 10 * k + 9] / mass[k] for k in range(3)]

        def says(p, mass=mass, centre=centre):
            yield [p.total_mass >= 1.05 * mass.sum(), p.total_mass <= 1.1 * mass.sum()]
            yield from (p.com_in_box(k, at - 0.02, at + 0.03) for k, at in enumerate(centre, start=1))
            yield p.density_in_ellipsoid(2, centre[1], [0.3, 0.3, 0.3])
            yield cp.norm(p.first_moment(3) - centre[2] * p["m3"]) <= 0.02 * p["m3"]

        constrained = replace(model, constraints=constraints_of(says, model))
        columns = model.columns(motion)[:, :, coefficients.selected].reshape(-1, len(coefficients))
        efforts = columns @ coefficients.project(truth)
        efforts += 0.03 * np.sqrt(np.mean(efforts**2)) * rng.normal(size=len(efforts))
        solver = ConeLeastSquares(constrained.cone, coefficients, columns.T @ columns, float(efforts @ efforts))
        few = rng.choice(len(efforts), 60, replace=False)
        rows, known = columns[few], efforts[few]
        made.append((solver, rows.T @ rows, rows.T @ known, float(known @ known)))
    return made


def test_the_lower_bound_is_near_the_optimum_though_few_rows_are_decided(few_rows):
    """With the solver's usual tolerance 0.07 % are left."""
    gaps = []
    for solver, hessian, gradient, energy in few_rows:
        best = solver.prepared(hessian).solve_precisely(gradient)
        found = solver.prepared(hessian).solve(gradient)
        assert found.lower_bound <= best.cost
        gaps.append((best.cost - found.lower_bound) / (energy + best.cost))
    assert max(gaps) < 1e-5


@pytest.mark.parametrize("rough", [0.1, 10.0])
def test_wrong_multipliers_never_raise_the_bound_above_the_optimum(few_rows, rough):
    for k, (solver, hessian, gradient, energy) in enumerate(few_rows):
        prepared = solver.prepared(hessian)
        best = prepared.solve_precisely(gradient)
        size = np.abs(best.multipliers)
        wrong = best.multipliers + rough * size * np.random.default_rng(k).normal(size=len(size))
        bound = prepared.bound_of(gradient, wrong)
        assert bound <= best.cost + 1e-9 * energy
        assert bound > best.cost - 1e-4 * energy
