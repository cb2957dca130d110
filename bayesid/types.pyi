"""The promised names of `bayesid.types`."""

from .discrepancy.comparison import ChangeReport as ChangeReport
from .excitation.assessment import ExcitationAssessment as ExcitationAssessment
from .excitation.design import ExcitationDesign as ExcitationDesign
from .excitation.next_motion import NextExperiment as NextExperiment
from .identification.gains import IdentifiedGains as IdentifiedGains
from .identification.payload import InertialParameters as InertialParameters
from .identification.payload import PayloadEstimate as PayloadEstimate
from .identification.prediction import PredictedEfforts as PredictedEfforts
from .log.gains import Gains as Gains
from .monitor.changes import Alarm as Alarm
from .monitor.tracker import TrackedSample as TrackedSample
from .regression.selection.fitted_effects import Thresholds as Thresholds
from .regression.stated import StatedParameters as StatedParameters
from .report.report_data import ReportData as ReportData
from .robot.collision import Capsules as Capsules
from .robot.collision import CollisionModel as CollisionModel
from .study.batch import BatchResult as BatchResult
