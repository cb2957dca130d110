"""A planned motion as robot controllers read it: tables and programs, each at a tenth, a third and all of the speed.

`PlannedMotion` says what is to be run, `save_programs` writes it; a module for each maker's language. A program is text
of the motion alone: nothing here looks at limits or collisions, so each says in its head what its caller has checked.
"""

from bayesid.export.controllers.planned import PlannedMotion
from bayesid.export.controllers.programs import PROGRAM_FILES, PROGRAM_FOLDERS, Programs, check_programs, save_programs

__all__ = ["PROGRAM_FILES", "PROGRAM_FOLDERS", "PlannedMotion", "Programs", "check_programs", "save_programs"]
