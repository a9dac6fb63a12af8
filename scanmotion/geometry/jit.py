"""numba for compiled loops, and small pieces of them: the home of njit.

Kernels work on one thread and let go of the interpreter where they run long (nogil); threads are started
outside of them, by `scanmotion.core.support.threads`. They keep to loops over elements: numpy's sorting,
searching and assigning of whole rows would be compiled anew for each kernel that uses them, and assigning a
row compiles a message about shapes, strings and all, which takes seconds.
"""

from numba import njit

__all__ = ["copy_into", "first_not_less", "njit", "sort_in_place", "turn_round"]


@njit(cache=True)
def copy_into(to, of):
    """Copies `of` (n,) into the first n places of `to`."""
    for i in range(len(of)):
        to[i] = of[i]


@njit(cache=True)
def turn_round(row, i, j):
    """Turns the stretch i..j of a row (n,) round, both ends included."""
    while i < j:
        row[i], row[j] = row[j], row[i]
        i += 1
        j -= 1


@njit(cache=True)
def first_not_less(ascending, value):
    """First place of an ascending row (n,) whose entry is not less than the value; n where there is none."""
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def sort_in_place(row, n):
    """Sorts the first n numbers of a row ascending: insertion for few, else heap sort (Williams 1964)."""
    if n <= 24:
        for i in range(1, n):
            value, k = row[i], i
            while k > 0 and row[k - 1] > value:
                row[k] = row[k - 1]
                k -= 1
            row[k] = value
        return
    root, end = n // 2, n
    while end > 1:
        if root > 0:
            root -= 1
        else:
            end -= 1
            row[0], row[end] = row[end], row[0]
        at = root
        while 2 * at + 1 < end:
            child = 2 * at + 1
            if child + 1 < end and row[child] < row[child + 1]:
                child += 1
            if row[at] >= row[child]:
                break
            row[at], row[child] = row[child], row[at]
            at = child
