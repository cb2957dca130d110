"""The promised names; `bayesid/__init__.py` loads each from here where it is first used."""

from . import types as types
from .discrepancy.finding import find_discrepancy as find_discrepancy
from .discrepancy.workflow import Discrepancy as Discrepancy
from .effects.model import Model as Model
from .errors import BayesidError as BayesidError
from .errors import InputError as InputError
from .errors import SolverError as SolverError
from .excitation.assessment import assess_excitation as assess_excitation
from .excitation.designing import design_excitation as design_excitation
from .excitation.settings import MotionSettings as MotionSettings
from .identification.identification import Identification as Identification
from .identification.identified_model import IdentifiedModel as IdentifiedModel
from .identification.model_file import load as load
from .identification.options import Preprocessing as Preprocessing
from .identification.payload import identify_payload as identify_payload
from .identification.pipeline import identify as identify
from .identification.prediction import Validation as Validation
from .log.log import Log as Log
from .log.reading import read_log as read_log
from .monitor.recursive_estimator import RecursiveEstimator as RecursiveEstimator
from .monitor.tracker import SignTracker as SignTracker
from .posterior.sampler import Sampling as Sampling
from .regression.knowledge import ParameterPrior as ParameterPrior
from .report import plot as plot
from .report.folders import make_report as make_report
from .report.saving import save as save
from .robot import Robot as Robot
from .robot import load_robot as load_robot
from .signs.search.beam import Beam as Beam
from .signs.search.certified import Certified as Certified
from .signs.search.protocol import Search as Search
from .simulation.logs import simulate as simulate
from .simulation.parameters import random_parameters as random_parameters
from .simulation.trajectories import random_trajectory as random_trajectory
from .study.batch import identify_each as identify_each

__version__: str
