"""An identification in a notebook: what its text says, the checks, and the efforts of the joint that fits worst."""

from __future__ import annotations

from markupsafe import Markup

from bayesid.identification.identification import Identification
from bayesid.parallel import one_at_a_time
from bayesid.report.findings import find_findings
from bayesid.report.pages.rendering import fragment
from bayesid.report.plot.efforts import WIDE, torques
from bayesid.report.plot.paper import Paper
from bayesid.report.verdicts import State, check_findings

_COLOURS: dict[State, str] = {"good": "#1f7a3d", "look": "#8a5a00", "bad": "#b3261e", "not done": "#59636e"}
"""As style.css has them; a notebook has no style of ours."""

_HEIGHT = 3.0
"""in, of the figure."""


@one_at_a_time
def identification_view(identification: Identification) -> str:
    """HTML that stands by itself: nothing is fetched, and no script runs."""
    findings = find_findings(identification)
    joint = int(identification.fit.relative_residual.argmax()) + 1
    figure = Paper(_HEIGHT, WIDE)
    torques(findings, joints=[joint], axes=[figure.subplots()])
    name = f"bayesid-{id(identification):x}"  # several outputs stand on one page
    alt = f"efforts of joint {joint}, recorded and by the model"
    return fragment(
        "notebook.html.jinja",
        text=repr(identification),
        checks=[(check, check.remedy, _COLOURS[check.state]) for check in check_findings(findings)],
        joint=joint,
        figure=Markup(figure.svg(name, alt)),
    )
