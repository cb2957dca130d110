"""Robot dynamics identification when the controller hides the sign of the motor currents.

import bayesid
result = bayesid.identify("ur10e", "log.csv")
result.beta, result.sd, result.sample_signs
result.validate("another_log.csv").relative_residual
bayesid.plot.torques(result)
bayesid.find_discrepancy(result, "another_log.csv").added

The names of __init__.pyi are promised, all else may change; each is loaded where it is first used.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
