"""Robot dynamics identification when the controller hides the sign of the motor currents.

import bayesid
result = bayesid.identify("ur10e", "log.csv")
result.beta, result.sd, result.sample_signs
result.validate("another_log.csv").relative_residual
bayesid.find_discrepancy(result, "another_log.csv").found
"""

from importlib.metadata import version

from bayesid.discrepancy.workflow import Discrepancy, find_discrepancy
from bayesid.errors import BayesidError, InputError, SolverError
from bayesid.identification import Identification, identify
from bayesid.log import Log, join_logs, read_log, write_log
from bayesid.nominal import read_nominal
from bayesid.results import load_model, save_discrepancy, save_identification, save_validation
from bayesid.robot import Robot, load_robot
from bayesid.separately import Separate, identify_separately
from bayesid.tables import inference_data
from bayesid.validation import Validation, validate

__version__ = version("bayesid")

__all__ = [
    "BayesidError", "Discrepancy", "Identification", "InputError", "Log", "Robot", "Separate", "SolverError",
    "Validation", "find_discrepancy", "identify", "identify_separately", "inference_data", "join_logs", "load_model",
    "load_robot", "read_log", "read_nominal", "save_discrepancy", "save_identification", "save_validation", "validate",
    "write_log",
]  # fmt: skip
