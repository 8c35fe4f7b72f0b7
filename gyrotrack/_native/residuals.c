/* Medians, and how unlikely residuals are: angles/oddity.py. */
#include "loops.h"

/* The value of a rank, 0 for the least; values change places. */
double ranked(double *values, Py_ssize_t count, Py_ssize_t rank)
{
    Py_ssize_t low = 0, high = count - 1;
    while (low < high) {
        double pivot = values[(low + high) / 2];
        Py_ssize_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (pivot < values[j])
                j--;
            if (i <= j) {
                double kept = values[i];
                values[i++] = values[j], values[j--] = kept;
            }
        }
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            break;
    }
    return values[rank];
}

/* The median; `guess` is where it may be, so that only what lies there is put in order. */
static double median(const double *values, Py_ssize_t count, double guess, double *room)
{
    double low = 0.9 * guess, high = 1.1 * guess;
    Py_ssize_t below = 0, within = 0, rank = (count - 1) / 2;
    for (Py_ssize_t k = 0; k < count; k++) {
        below += values[k] < low;
        room[within] = values[k];
        within += values[k] >= low && values[k] <= high;
    }
    if (rank < below || count / 2 >= below + within) {
        below = 0, within = count;
        for (Py_ssize_t k = 0; k < count; k++)
            room[k] = values[k];
    }
    double middle = ranked(room, within, rank - below);
    return count % 2 ? middle : 0.5 * (middle + ranked(room, within, rank - below + 1));
}

/* unlikely(squares, odd, shares, out, fault) */
PyObject *loops_unlikely(PyObject *self, PyObject *args)
{
    PyObject *given[4], *done = NULL;
    double fault, guess = 0.0, *room = NULL;
    Py_buffer views[4];
    Arrays arrays = {views, 0};
    if (!PyArg_ParseTuple(args, "OOOOd", &given[0], &given[1], &given[2], &given[3], &fault))
        return NULL;
    Py_buffer *a = take(&arrays, given, "1d1d1d1D");
    if (a == NULL)
        goto end;
    Py_ssize_t count = a->shape[0];
    const double *squares = a[0].buf, *odd = a[1].buf, *share = a[2].buf;
    if (count < 1 || a[1].shape[0] != count || a[3].shape[0] != a[2].shape[0]) {
        misfit();
        goto end;
    }
    room = PyMem_Calloc(2 * count, sizeof(double));
    if (room == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t which = 0; which < a[2].shape[0]; which++) {
        double logarithm = 0.0, total = 0.0, product = 1.0;
        for (Py_ssize_t k = 0; k < count; k++)
            room[k] = squares[k] / (1.0 + share[which] * odd[k]);
        for (Py_ssize_t k = 0; k < count; k++) {
            product *= 1.0 + share[which] * odd[k];
            if (product > 1e200 || k + 1 == count)
                logarithm += log(product), product = 1.0;
        }
        guess = median(room, count, guess, room + count);
        for (Py_ssize_t k = 0; k < count; k++)
            total += fmin(room[k], fault * guess);
        ((double *)a[3].buf)[which] = log(fmax(total / (double)count, 1e-30)) + logarithm / (double)count;
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    PyMem_Free(room);
    give_back(&arrays);
    return done;
}
