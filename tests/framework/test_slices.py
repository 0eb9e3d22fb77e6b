"""Parts of a column, against NumPy's split."""

from __future__ import annotations

import numpy as np
import pytest

from dmframe.common.slices import slices


@pytest.mark.parametrize("sizes", [[], [3], [2, 0, 3, 1], [0, 0]])
def test_a_column_is_split_where_numpy_splits_it(sizes: list[int]) -> None:
    column = np.arange(sum(sizes))
    expected = np.split(column, np.cumsum(sizes)[:-1]) if sizes else []
    found = [column[part] for part in slices(sizes)]
    assert [part.tolist() for part in found] == [part.tolist() for part in expected]
