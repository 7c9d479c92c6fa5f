"""What names a piece of work: equal for equal values, other for others."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from viatool.schedule.digest import digest_of


def test_a_sparse_matrix_is_named_by_its_numbers_and_their_places():
    dense = np.zeros((4, 5))
    dense[1, 2], dense[3, 0] = 2.0, -1.0
    moved, other = dense.copy(), dense.copy()
    moved[1, 2], moved[1, 3] = 0.0, 2.0
    other[1, 2] = 3.0
    assert digest_of(csr_array(dense)) == digest_of(csr_array(dense.copy()))
    assert len({digest_of(csr_array(matrix)) for matrix in (dense, moved, other, dense[:, :4])}) == 4


def test_what_might_look_different_each_time_has_no_name():
    with pytest.raises(TypeError, match="object has no digest"):
        digest_of({"work": object()})
