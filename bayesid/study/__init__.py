"""Many tasks on many cores: separate logs, whether their results agree, and the list of all studies."""

STUDIES = {
    "noise": "how much noise in the efforts can the signs bear?",
    "duration": "how short may a log be?",
    "excitation": "how poor may the excitation be?",
    "cutoff": "which cut-off of the low-pass is right, and does the automatic one find it?",
    "threshold": "how deep must a minimum be to cut there, and which small efforts should be dropped?",
    "beam_width": "how wide must the beam of T-PBPR be?",
    "initial_segments": "how many segments should T-PBPR enumerate first?",
    "prior": "what does the prior decide, and what do values from a drawing change?",
    "scaling": "what does a larger robot or a longer log cost?",
    "paper": "the paper's experiment, its numbers beside ours",
    "real": "real logs with their signs hidden: which come back right?",
    "calibration": "do confidences and standard deviations mean what they say?",
    "misfit": "the same with an effect that the model does not hold",
    "sure": "how many signs are said to be sure and are wrong?",
    "poor": "are signs right and effects named where the rigid model is poor?",
    "gains": "what do |currents| tell of gains that are uncertain?",
    "tracking": "what does a tracker see of a robot that runs?",
    "next_motion": "does the motion designed for a result settle what the result leaves open, as predicted?",
    "sbc": "does the sampler sample the posterior?",
    "complete": "what does the catalogue give an identification that names no effects?",
    "discrepancy": "is the missing effect named? Blind cases played by MuJoCo",
    "discrepancy_sets": "the same by kind: sets of effects, fresh forms, a table that is off, beside their targets",
    "discrepancy_misfit": "the same where the model or the noise is wrong in all logs alike",
    "real_discrepancy": "the same on real logs of a UR10e",
}
"""Modules of `bayesid.studies`, and the question that each answers."""
