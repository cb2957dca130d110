"""Robot dynamics identification when the controller hides the sign of the motor currents.

import bayesid
result = bayesid.identify("ur10e", "log.csv")
result.beta, result.sd, result.sample_signs
result.validate("another_log.csv").relative_residual
bayesid.plot.torques(result)
bayesid.find_discrepancy(result, "another_log.csv").found
"""

from importlib import import_module
from importlib.metadata import version
from types import ModuleType

from bayesid.discrepancy.workflow import Discrepancy, find_discrepancy
from bayesid.errors import BayesidError, InputError, SolverError
from bayesid.excitation.design import ExcitationDesign, design_excitation
from bayesid.excitation.files import save_design
from bayesid.excitation.judgement import ExcitationJudgement, judge_log
from bayesid.excitation.limits import read_limits
from bayesid.identification import Identification, identify
from bayesid.log import Log, join_logs, read_log, write_log
from bayesid.nominal import read_nominal
from bayesid.results import load_model, make_report, save_discrepancy, save_identification, save_validation
from bayesid.robot import Robot, load_robot
from bayesid.separately import Separate, identify_separately
from bayesid.tables import inference_data
from bayesid.validation import Validation, validate

__version__ = version("bayesid")

__all__ = [
    "BayesidError", "Discrepancy", "ExcitationDesign", "ExcitationJudgement", "Identification", "InputError", "Log",
    "Robot", "Separate", "SolverError", "Validation", "design_excitation", "find_discrepancy", "identify",
    "identify_separately", "inference_data", "join_logs", "judge_log", "load_model", "load_robot", "make_report",
    "read_limits", "read_log", "read_nominal", "save_design", "save_discrepancy", "save_identification",
    "save_validation", "validate", "write_log",
]  # fmt: skip


def __getattr__(name: str) -> ModuleType:
    """`bayesid.plot` is there without an import of its own, but loads matplotlib only where it is used."""
    if name == "plot":
        return import_module("bayesid.plot")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
