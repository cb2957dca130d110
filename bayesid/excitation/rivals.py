"""Hypotheses that a log cannot tell apart, and how clearly a motion would tell.

Each hypothesis is the model without the effects in question, with columns of one of them. What is linear in an effect's
numbers is summed out (`bayesid.excitation.bayes_factors`); of its forms with other numbers the one counts that imitates
best. So what is expected is that of the least clear case.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.discrepancy.workflow import CHANGE_OF
from bayesid.effects import Distortion, Term, catalogue
from bayesid.effects.catalogue import main_forms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.bayes_factors import BayesFactors, FormKnowledge
from bayesid.excitation.known import Known, information_of, inverse, scaled_spectrum
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.hypotheses import EffectKey, forms_of, maker

_RANK = 1e-6
"""Share of a column's length that others must leave for a motion to tell it from them."""
Changes = Mapping[EffectKey, Mapping[str, float]]
"""Hypotheses that a term of the model has changed, and by how much which parameters, where the result has found it."""
NO_CHANGES: Changes = {}


@dataclass(frozen=True)
class Hypotheses:
    """Classes of effects of which each class is to be told apart.

    Attributes:
        classes: effect and joints (from 1) of each hypothesis, the one that was named first.
        changed: those that are a change of a term which the model had before, and by how much which parameters.
    """

    classes: tuple[tuple[EffectKey, ...], ...] = ()
    changed: Changes = field(default_factory=dict)


def hypotheses_of(names: Sequence[str]) -> Hypotheses:
    """One class by its names, as in ("stribeck_friction:3", "thermal_drift:3"); none of no names."""
    return Hypotheses((tuple(map(parse_key, names)),) if names else ())


def hypotheses_after(
    found: Sequence[AddedEffect], classes: tuple[tuple[EffectKey, ...], ...], *, asked: bool
) -> Hypotheses:
    """Hypotheses of a discrepancy that has found some effects.

    Args:
        found: by the discrepancy.
        classes: that are named.
        asked: whether effects that its log could not tell apart are meant where none are named.
    """
    changed: dict[EffectKey, dict[str, float]] = {}
    for added in found:
        changed |= {score.key: {} for score in added.rivals if score.hypothesis.changes}
    for added in found:
        steps = {name: added.parameters[f"{CHANGE_OF}{name}"][0] for name in added.hypothesis.changes}
        if steps:
            changed[added.hypothesis.key] = steps
    if asked and not classes:
        classes = equivalent_classes([(one.effect, one.joints, _equivalents(one)) for one in found])
    return Hypotheses(classes, changed)


def _equivalents(added: AddedEffect) -> list[str]:
    """Names of the effects that are equivalent to one, with the joints in which they are, as `--between` takes them."""
    keys = {score.hypothesis.effect: score.key for score in reversed(added.rivals)}  # the best of each name
    found = (keys.get(name) for name in added.equivalent)
    return [
        name if key is None else f"{name}:{':'.join(map(str, key[1]))}"  # with no joint behind it, the whole robot
        for name, key in zip(added.equivalent, found, strict=True)
    ]


def equivalent_classes(
    found: Sequence[tuple[str, tuple[int, ...], Sequence[str]]],
) -> tuple[tuple[EffectKey, ...], ...]:
    """Classes of hypotheses that a log could not tell apart: effect and joints of each, the one that was named first.

    Args:
        found: effect, joints and names of the effects that are equivalent, of each effect that was found. These act in
            the same joints, or in the whole robot where they can in no joint alone, unless their names say more
            ("thermal_drift:3", and "delay:" in the whole robot).
    """
    told = [one for one in found if one[2]]
    return tuple(
        ((effect, joints), *(parse_key(other) if ":" in other else _placed(other, joints) for other in equivalent))
        for effect, joints, equivalent in told
    )


def _placed(effect: str, joints: tuple[int, ...]) -> EffectKey:
    kind = main_forms().get(effect)
    return effect, joints if kind is None or kind.by_joint else ()


@dataclass(frozen=True)
class RivalForm:
    """One form of a hypothesis.

    Attributes:
        source: term or distortion.
        place: of its columns among all, its amplitudes first.
        sd: (p,) of its amplitudes beforehand; `TUNING.shift` of a change without amplitude.
        mean: (p,) of them beforehand.
    """

    source: Effect
    place: slice
    sd: Array
    mean: Array

    @property
    def columns(self) -> Integers:
        """(p,) places of its columns."""
        return np.arange(self.place.start, self.place.stop)


@dataclass(frozen=True)
class Rival:
    """A hypothesis.

    Attributes:
        key: effect and joints.
        forms: with different numbers.
        own: (p,) amplitudes of its first form that the result has found; None where the result has not got it.
    """

    key: EffectKey
    forms: tuple[RivalForm, ...]
    own: Array | None

    @property
    def name(self) -> str:
        """As `--between` takes it."""
        effect, joints = self.key
        return ":".join([effect, *map(str, joints)])


@dataclass(frozen=True)
class RivalEffects:
    """Hypotheses, and what is known beside them.

    Attributes:
        known: the result without the effects in question.
        rivals: at least two.
        recorded: (R, R) information of the earlier recording on all columns; zero where its motion is not at hand.
        prior: (r, r) inverse covariance of the coefficients before it, or of now where its motion is not at hand.
    """

    known: Known
    rivals: tuple[Rival, ...]
    recorded: Array
    prior: Array

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """The true one first."""
        return [(a, b) for a in self.rivals for b in self.rivals if a is not b]

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) those of the coefficients, then those of all forms."""
        base = self.known.columns(motion)
        parts = [base]
        scene = self.known.model.scene(motion, self.known.theta, base @ self.known.mean, np.abs(base @ self.known.mean))
        for rival in self.rivals:
            for form in rival.forms:
                shift, rows = form.source.change(scene)
                parts.append(rows)
                if form.place.stop - form.place.start > rows.shape[2]:
                    parts.append(shift[:, :, None])
        return np.concatenate(parts, axis=2)

    @property
    def memory(self) -> bool:
        """Whether a row depends on other instants too."""
        return self.known.memory or any(form.source.memory for rival in self.rivals for form in rival.forms)

    def worth(self, information: Array) -> float:
        """Minus the expected log Bayes factors, nats, each up to twice what tells, for it scatters about that.

        A hypothesis that is a special case of another is never told clearly from it, and must not hold up the others.
        """
        return -float(np.minimum(self._factors.expected(information), 2.0 * TUNING.telling * LN10).sum())

    def expected(self, information: Array) -> dict[tuple[str, str], float]:
        """Expected log Bayes factor, nats, of each hypothesis if it is true, against each other."""
        factors = self._factors.expected(information).tolist()
        return {(a.name, b.name): value for (a, b), value in zip(self.pairs, factors, strict=True)}

    @cached_property
    def _factors(self) -> BayesFactors:
        under = self._under
        return BayesFactors(
            len(self.known),
            [
                (self._truth[true.name][0], [under[form.place.start, true.name] for form in other.forms])
                for true, other in self.pairs
            ],
        )

    @cached_property
    def _truth(self) -> dict[str, tuple[FormKnowledge, RivalForm]]:
        """What is true where each of the hypotheses is, and in which form."""
        found = next((rival for rival in self.rivals if rival.own is not None), None)
        cases = {}
        for rival in self.rivals:
            form = rival.forms[len(rival.forms) // 2]
            if rival.own is not None:
                form = rival.forms[0]
                own = replace(form, mean=rival.own)
                cases[rival.name] = self._after(own, np.concatenate([self.known.mean, rival.own]), form), form
            elif found is None:
                cases[rival.name] = self._after(form, np.concatenate([self.known.mean, form.mean]), form), form
            else:
                mimics = [(self._mimic(one, found), one) for one in rival.forms]
                cases[rival.name] = max(mimics, key=lambda mimic: mimic[0].fit)
        return cases

    def _mimic(self, form: RivalForm, found: Rival) -> FormKnowledge:
        return self._after(form, np.concatenate([self.known.mean, np.asarray(found.own)]), found.forms[0])

    @cached_property
    def _under(self) -> dict[tuple[int, str], FormKnowledge]:
        """What each form of a hypothesis holds for true after the earlier recording, where another one is true."""
        cases = {}
        for true, other in self.pairs:
            case, of = self._truth[true.name]
            for form in other.forms:
                cases[form.place.start, true.name] = self._after(form, case.mean, of)
        return cases

    def best_fit(self, form: RivalForm, rival: Rival) -> float:
        """How well a form of a hypothesis fits the earlier recording where one of the others is true."""
        truths = [self._truth[one.name] for one in self.rivals if one is not rival]
        return max(self._after(form, case.mean, of).fit for case, of in truths)

    def _after(self, form: RivalForm, truth: Array, of: RivalForm) -> FormKnowledge:
        """A form after the earlier recording, in which another form was true with quantities (R,)."""
        r = len(self.known)
        own, true = (np.concatenate([np.arange(r), one.columns]) for one in (form, of))
        before = np.diag(1.0 / np.concatenate([np.ones(r), form.sd]) ** 2)
        before[:r, :r] = self.prior
        mean = np.concatenate([self.known.mean, form.mean])
        seen = self.recorded[np.ix_(own, own)]
        pull = before @ mean + self.recorded[np.ix_(own, true)] @ truth
        precision = before + seen
        estimate = inverse(precision) @ pull
        fit = float(pull @ estimate - mean @ before @ mean)
        return FormKnowledge(own, estimate, precision, fit)


def make_rivals(
    known: Known, keys: Sequence[EffectKey], earlier: Motion | None, reference: Motion, changed: Changes = NO_CHANGES
) -> RivalEffects:
    """Hypotheses of a result.

    Args:
        known: the result.
        keys: effects and joints (from 1), two or more.
        earlier: N instants of the motion of the result's log, evenly thinned; None where it is not at hand.
        reference: a motion on which forms are made where the earlier one is not at hand.
        changed: of these, hypotheses that a term has changed which the model had before.

    Raises:
        InputError: an effect is not in the catalogue, or has no form in these joints.
    """
    if len(set(keys)) < 2:
        raise InputError(
            "takes two different hypotheses", field="between", remedy="as in stribeck_friction:3,thermal_drift:3"
        )
    bare, found = _without(known, [key for key in keys if key not in changed])
    prior = None if earlier is None else _before(known, bare, earlier)
    bare, steps = _as_before(bare.undelayed, {key: changed[key] for key in keys if key in changed})
    scene_motion = reference if earlier is None else earlier
    effort = np.einsum("njr,r->nj", bare.columns(scene_motion), bare.mean)
    scene = bare.model.scene(scene_motion, bare.theta, effort, np.abs(effort))
    actuators = bare.model.robot.actuators(scene_motion)
    used = np.abs(actuators.dq) > actuators.standstill_speed
    make = maker(bare.model, scene, used)
    rivals, place = [], len(bare)
    for key in keys:
        own = found.get(key)
        hypotheses = [one for group in forms_of(*key, make, scene) for one in group]
        if own is not None:
            hypotheses = [make(own[0]), *hypotheses]
        if not hypotheses:
            raise InputError(f"{key[0]!r} has no form in {_joints(key)}", field="between", remedy=_remedy())
        forms = []
        for one in hypotheses:
            shift = any(np.any(values) for values in one.columns.shift.values())
            sd = np.concatenate([one.columns.sd, np.full(int(shift), TUNING.shift)])
            mean = np.concatenate([np.zeros(len(one.columns.sd)), np.ones(int(shift))])
            forms.append(RivalForm(one.source, slice(place, place + len(sd)), sd, mean))
            place += len(sd)
        amplitudes = steps.get(key) if own is None else _amplitudes(forms[0], own[1])
        rivals.append(Rival(key, tuple(forms), amplitudes))
    made = RivalEffects(bare, tuple(rivals), np.zeros((place, place)), bare.precision)
    if earlier is None:
        return _likeliest(made)
    recorded = information_of(made.columns(earlier), made.known.weights(earlier, _period(earlier)))
    assert prior is not None
    for rival in rivals:
        if rival.key in steps:
            prior = _unstepped(prior, bare, list(changed[rival.key]), rival.forms[0].sd)
    return _likeliest(replace(made, recorded=recorded, prior=prior))


def _period(motion: Motion) -> float:
    return float(motion.t[-1] - motion.t[0]) / max(len(motion) - 1, 1)


def _as_before(known: Known, changed: Changes) -> tuple[Known, dict[EffectKey, Array]]:
    """The result with terms as they were before they changed, and by how much they did, where that was found."""
    names = [parameter.name for parameter in known.model.parameters]
    steps = {key: np.array(list(step.values())) for key, step in changed.items() if step}
    theta = known.theta.copy()
    for key, step in steps.items():
        theta[[names.index(name) for name in changed[key]]] -= step
    if not steps:
        return known, steps
    mean = known.mean.copy()
    mean[: len(known.coefficients)] = known.coefficients.project(theta)
    return replace(known, theta=theta, mean=mean), steps


def _unstepped(prior: Array, bare: Known, parameters: Sequence[str], sd: Array) -> Array:
    """The inverse covariance before, without the step that parameters were taken to have made (`Knowledge.widened`).

    Where that step, of standard deviations (p,), is all that was uncertain of a coefficient, a `TUNING.wider`th of it
    is left.
    """
    names = [parameter.name for parameter in bare.model.parameters]
    step = np.zeros((len(bare), len(parameters)))
    step[: len(bare.coefficients)] = bare.coefficients.projection[:, [names.index(name) for name in parameters]]
    root = np.linalg.cholesky(prior)
    whitened = root.T @ step * sd[: len(parameters)]
    sizes, turn = np.linalg.eigh(whitened @ whitened.T)
    spread = np.linalg.inv(root).T @ turn * np.sqrt(np.clip(1.0 - sizes, 1.0 / TUNING.wider**2, 1.0))
    return inverse(spread @ spread.T)


def _before(known: Known, bare: Known, earlier: Motion) -> Array:
    """(r, r) inverse covariance of the quantities before the earlier recording, by what is known beside it.

    What the recording tells is taken from what is known now; where it tells all of it, next to nothing was known.
    """
    values, vectors, scale = scaled_spectrum(known.precision)
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, np.finfo(float).tiny))  # L = root root'
    whiten = np.linalg.pinv(root)
    told, turn = np.linalg.eigh(whiten @ known.information(earlier, _period(earlier)) @ whiten.T)
    left = np.clip(1.0 - told, 1.0 / TUNING.wider**2, 1.0)
    spread = whiten.T @ turn / np.sqrt(left)
    if bare is not known:
        spread = _turn(known, bare.model) @ spread[: len(known.coefficients)]
    return inverse(spread @ spread.T)


def _turn(known: Known, model: Model) -> Array:
    """(r, R) what takes coefficients to those of the same model without some terms."""
    names = [parameter.name for parameter in known.model.parameters]
    kept = [names.index(parameter.name) for parameter in model.parameters]
    turn: Array = base_coefficients(model).projection @ np.linalg.pinv(known.coefficients.projection[:, kept])
    return turn


def _likeliest(rivals: RivalEffects) -> RivalEffects:
    """The forms of each hypothesis that imitate the others best on the earlier recording; evenly many without one."""
    chosen = [_chosen(rivals, rival) for rival in rivals.rivals]
    r = len(rivals.known)
    kept = np.concatenate([np.arange(r), *(form.columns for forms in chosen for form in forms)])
    place, left = r, []
    for rival, forms in zip(rivals.rivals, chosen, strict=True):
        moved = []
        for form in forms:
            moved.append(replace(form, place=slice(place, place + len(form.sd))))
            place += len(form.sd)
        left.append(replace(rival, forms=tuple(moved)))
    return replace(rivals, rivals=tuple(left), recorded=rivals.recorded[np.ix_(kept, kept)])


def _chosen(rivals: RivalEffects, rival: Rival) -> list[RivalForm]:
    """As many forms as are looked at; the one that the result has found is the first of them."""
    forms, first = list(rival.forms), int(rival.own is not None)
    if len(forms) <= TUNING.most_forms:
        return forms
    if not rivals.recorded.any():
        return [forms[k] for k in np.unique(np.linspace(0, len(forms) - 1, TUNING.most_forms).astype(int))]
    fits = [rivals.best_fit(form, rival) for form in forms[first:]]
    best = np.sort(np.argsort(fits)[::-1][: TUNING.most_forms - first]) + first
    return [*forms[:first], *(forms[k] for k in best)]


def _amplitudes(form: RivalForm, theta: Array) -> Array:
    """(p,) of a form that the result has: a term's parameters, or nothing beside the change that a distortion is."""
    return np.concatenate([theta, form.mean[len(theta) :]])


def parse_key(text: str) -> EffectKey:
    """An effect and its joints, as in `stribeck_friction:3`.

    Raises:
        InputError: it is none of the catalogue.
    """
    effect, *joints = text.strip().split(":")
    known = {kind.name.split(".")[0] for kind in catalogue.forms().values()}
    if effect not in known:
        raise InputError(f"{effect!r} is no effect of the catalogue", field="between", remedy=_remedy())
    try:
        return effect, tuple(int(joint) for joint in joints if joint)
    except ValueError:
        raise InputError(f"{text!r}: joints are whole numbers", field="between", remedy=_remedy()) from None


def _remedy() -> str:
    return "give effects with their joints, as in stribeck_friction:3,thermal_drift:3 (docs/discrepancy.md has all)"


def _joints(key: EffectKey) -> str:
    return f"joint {', '.join(map(str, key[1]))}" if key[1] else "the whole robot"


def _without(known: Known, keys: Sequence[EffectKey]) -> tuple[Known, dict[EffectKey, tuple[Effect, Array]]]:
    """The result without some effects, and those that it has: the effect and its amplitudes."""
    found: dict[EffectKey, tuple[Effect, Array]] = {}
    terms: list[Term] = []
    kept: list[int] = []
    for term, place in zip(known.model.terms, known.model.places, strict=True):
        key = term.effect, term.joints
        if key in keys:
            found[key] = (term, known.theta[place])
            continue
        terms.append(term)
        kept += range(place.start, place.stop)
    distortions: list[Distortion] = []
    for one in known.model.distortions:
        key = one.effect, one.joints
        if key in keys:
            found[key] = (one, np.zeros(0))
        else:
            distortions.append(one)
    if not found:
        return known, found
    model, theta = Model(known.model.robot, tuple(terms), tuple(distortions)), known.theta[kept]
    base, turn = base_coefficients(model), _turn(known, model)
    covariance = known.now[: len(known.coefficients), : len(known.coefficients)]
    left = turn @ covariance @ turn.T
    precision = inverse(left)
    bare = replace(
        known,
        model=model,
        coefficients=base,
        theta=theta,
        names=base.names,
        units=base.units,
        mean=base.project(theta),
        precision=precision,
        lacking=np.zeros_like(precision),
        gains=np.empty(0, dtype=np.int64),
    )
    return bare, found


def inseparable(rivals: RivalEffects, motion: Motion) -> list[tuple[str, str]]:
    """Pairs that no motion tells apart: a rich one shows each in columns that the other has too."""
    columns = rivals.columns(motion)
    rows = columns.reshape(-1, columns.shape[2])
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    r, pairs = len(rivals.known), []
    base, own = rows[:, :r], rows[:, r:]
    beside = own - base @ np.linalg.lstsq(base, own, rcond=None)[0]  # what the coefficients leave of each column
    for k, a in enumerate(rivals.rivals):
        for b in rivals.rivals[k + 1 :]:
            if any(
                _among(beside[:, one.columns - r], beside[:, other.columns - r])
                and _among(beside[:, other.columns - r], beside[:, one.columns - r])
                for one in a.forms
                for other in b.forms
            ):
                pairs.append((a.name, b.name))
    return pairs


def _among(columns: Array, others: Array) -> bool:
    """Whether columns (N, p) are combinations of others (N, k)."""
    left = columns - others @ np.linalg.lstsq(others, columns, rcond=_RANK)[0]
    return bool(np.linalg.norm(left, axis=0).max(initial=0.0) <= _RANK)
