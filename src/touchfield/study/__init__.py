"""Forced-choice studies: procedures, a simulated observer, trials as text, and the analysis of them. Nothing
here plays or opens a stream (`touchfield.tasks.study` does)."""

from touchfield.study.analysis import Fit, fit_psychometric, power_of
from touchfield.study.design import Comparison, StudyDesign, read_design
from touchfield.study.procedures import procedure_of
from touchfield.study.psychometric import Psychometric, SimulatedObserver
from touchfield.study.trials import Trial, read_trials

__all__ = [
    "Comparison", "Fit", "Psychometric", "SimulatedObserver", "StudyDesign", "Trial", "fit_psychometric",
    "power_of", "procedure_of", "read_design", "read_trials",
]  # fmt: skip
