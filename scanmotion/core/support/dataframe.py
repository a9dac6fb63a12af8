"""Tables for those who have pandas; nothing here needs it otherwise."""

import importlib
from collections.abc import Mapping
from typing import Any

from scanmotion.core.errors import InputError


def dataframe(columns: Mapping[str, Any]) -> Any:
    """A pandas DataFrame of columns of one length.

    Args:
        columns: values by name of the column, shape (n,) each.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ImportError:
        raise InputError("to_dataframe needs pandas: pip install pandas") from None
    return pandas.DataFrame(dict(columns))
