"""Small dense systems, solved in compiled code without an allocation."""

import numpy as np

from softrl.core.compiled import borrowing


@borrowing
def solve_positive(matrix: np.ndarray, right: np.ndarray, answer: np.ndarray) -> bool:
    """Fill ``answer`` with matrix^-1 right by LDL', overwriting ``matrix``; return whether it is positive definite."""
    n = len(right)
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k] * matrix[k, k]
        if not pivot > 0.0:
            return False
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            entry = matrix[i, j]
            for k in range(j):
                entry -= matrix[i, k] * matrix[j, k] * matrix[k, k]
            matrix[i, j] = entry / pivot
    for i in range(n):
        total = right[i]
        for k in range(i):
            total -= matrix[i, k] * answer[k]
        answer[i] = total
    for i in range(n):
        answer[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            answer[i] -= matrix[k, i] * answer[k]
    return True


@borrowing
def solve_general(matrix: np.ndarray, right: np.ndarray, answer: np.ndarray) -> bool:
    """Fill ``answer`` by elimination with row pivots, overwriting ``matrix``; return whether it descends.

    It descends if ``answer.right > 0``, as it does for every matrix with positive symmetric part.
    """
    n = len(right)
    for i in range(n):
        answer[i] = right[i]
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(matrix[i, j]) > abs(matrix[best, j]):
                best = i
        if matrix[best, j] == 0.0:
            return False
        if best != j:
            for k in range(n):
                matrix[j, k], matrix[best, k] = matrix[best, k], matrix[j, k]
            answer[j], answer[best] = answer[best], answer[j]
        for i in range(j + 1, n):
            share = matrix[i, j] / matrix[j, j]
            for k in range(j, n):
                matrix[i, k] -= share * matrix[j, k]
            answer[i] -= share * answer[j]
    along = 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            answer[i] -= matrix[i, k] * answer[k]
        answer[i] /= matrix[i, i]
    for i in range(n):
        along += answer[i] * right[i]
    return along > 0.0


@borrowing
def newton_direction(
    hessian: np.ndarray,
    quadratic: np.ndarray,
    gradient: np.ndarray,
    symmetric: bool,
    scratch: np.ndarray,
    direction: np.ndarray,
) -> None:
    """Fill ``direction`` with hessian^-1 gradient; as much of ``quadratic`` is added as a descent needs."""
    shift = 0.0
    n = len(gradient)
    for _ in range(20):
        for i in range(n):
            for j in range(n):
                scratch[i, j] = hessian[i, j] + shift * quadratic[i, j]
        if symmetric:
            if solve_positive(scratch, gradient, direction):
                return
        elif solve_general(scratch, gradient, direction):
            return
        shift = 0.01 if shift == 0.0 else 4.0 * shift
