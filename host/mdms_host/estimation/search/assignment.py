"""Assignment at the least total cost: exact, for few (Jonker and Volgenant's method).

Rows are assigned one after the other, each along the shortest augmenting path over reduced costs.
"""

import numpy as np

from mdms_model.arrays import Floats, Ints


def assign(cost: Floats) -> Ints:
    """The column of each row, all different, for which the sum of `cost` (R, C) is least, (R,).

    Needs finite costs, and no fewer columns than rows. Takes R^2 steps of C.
    """
    rows, columns = cost.shape
    # Column 0 is where a row that is not assigned yet stands; potentials are of rows and columns.
    row_of = np.zeros(columns + 1, dtype=np.int64)
    rows_m, columns_m = np.zeros(rows + 1), np.zeros(columns + 1)
    for row in range(1, rows + 1):
        row_of[0] = row
        here, before = 0, np.zeros(columns + 1, dtype=np.int64)
        shortest, reached = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=bool)
        while row_of[here]:
            reached[here] = True
            from_row = row_of[here]
            reduced = cost[from_row - 1] - rows_m[from_row] - columns_m[1:]
            nearer = ~reached[1:] & (reduced < shortest[1:])
            shortest[1:][nearer] = reduced[nearer]
            before[1:][nearer] = here
            open_ = np.where(reached[1:], np.inf, shortest[1:])
            here = int(open_.argmin()) + 1
            step = open_[here - 1]
            rows_m[row_of[reached]] += step
            columns_m[reached] -= step
            shortest[1:][~reached[1:]] -= step
        while here:
            row_of[here] = row_of[before[here]]
            here = int(before[here])
    column_of = np.zeros(rows, dtype=np.int64)
    for column in range(1, columns + 1):
        if row_of[column]:
            column_of[row_of[column] - 1] = column - 1
    return column_of
