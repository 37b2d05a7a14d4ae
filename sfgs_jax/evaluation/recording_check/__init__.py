"""Faults of a recording that would spoil a run, found in a sample of its frames before the run.

Each file asks one question. No answer is guessed: what the data can't tell is said to be unknown.
"""

from sfgs_jax.evaluation.recording_check._check import RecordingCheck as RecordingCheck
from sfgs_jax.evaluation.recording_check._check import check_recording as check_recording
from sfgs_jax.evaluation.recording_check._finding import Finding as Finding
from sfgs_jax.evaluation.recording_check._finding import Severity as Severity
