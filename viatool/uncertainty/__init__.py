"""What is bounded about a real robot: the error model, its terms and its file."""

from viatool.uncertainty.error_file import as_error_model, load_errors
from viatool.uncertainty.error_model import ErrorModel

__all__ = ["ErrorModel", "as_error_model", "load_errors"]
