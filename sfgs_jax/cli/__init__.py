"""The command line, `sfgs-jax`: its commands as functions, and the settings that a run stores."""

from sfgs_jax.cli._ablations import ABLATIONS as ABLATIONS
from sfgs_jax.cli._ablations import ablated as ablated
from sfgs_jax.cli._check import CheckArguments as CheckArguments
from sfgs_jax.cli._check import check_command as check_command
from sfgs_jax.cli._check import check_text as check_text
from sfgs_jax.cli._configuration import RunConfig as RunConfig
from sfgs_jax.cli._configuration import from_json as from_json
from sfgs_jax.cli._configuration import read_config as read_config
from sfgs_jax.cli._configuration import to_json as to_json
from sfgs_jax.cli._doctor import DoctorArguments as DoctorArguments
from sfgs_jax.cli._doctor import doctor_command as doctor_command
from sfgs_jax.cli._evaluate import EvalArguments as EvalArguments
from sfgs_jax.cli._evaluate import eval_command as eval_command
from sfgs_jax.cli._export import ExportArguments as ExportArguments
from sfgs_jax.cli._export import export_command as export_command
from sfgs_jax.cli._main import COMMANDS as COMMANDS
from sfgs_jax.cli._main import Command as Command
from sfgs_jax.cli._main import main as main
from sfgs_jax.cli._progress import Reporter as Reporter
from sfgs_jax.cli._progress import reporting as reporting
from sfgs_jax.cli._run import RunOptions as RunOptions
from sfgs_jax.cli._run import run_command as run_command
from sfgs_jax.cli._summary import summary as summary
from sfgs_jax.cli._view import ViewArguments as ViewArguments
from sfgs_jax.cli._view import view_command as view_command
