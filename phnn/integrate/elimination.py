"""Small linear systems inside the steps."""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import plain, stay_outside


@plain
def eliminate(matrix: Any, right: Any) -> None:
    """Solve a small linear system in place by elimination with row pivoting; ``right`` (m, k) becomes the solution."""
    stay_outside()
    m, columns = right.shape
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(m):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for c in range(columns):
                right[k, c], right[pivot, c] = right[pivot, c], right[k, c]
        for i in range(k + 1, m):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, m):
                matrix[i, j] -= share * matrix[k, j]
            for c in range(columns):
                right[i, c] -= share * right[k, c]
    for k in range(m - 1, -1, -1):
        inverse = 1.0 / matrix[k, k]
        for j in range(k + 1, m):
            for c in range(columns):
                right[k, c] -= matrix[k, j] * right[j, c]
        for c in range(columns):
            right[k, c] *= inverse
