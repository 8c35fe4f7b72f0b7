/* Local polynomials: geometry/local.py. */
#include "loops.h"

#define LANES 8 /* fits that are made side by side */
#define POWERS 9 /* moments up to twice a cubic's, with two for the bell */

/* Turn sums of w u^p, p = 0 to `most`, into sums of w (u - c)^p, and these into sums with the weights 1 - (u - c)^2. */
static void centred(double sum[POWERS][LANES], const double *c, int most)
{
    for (int done = 0; done < most; done++)
        for (int p = most; p > done; p--)
            for (int k = 0; k < LANES; k++)
                sum[p][k] -= c[k] * sum[p - 1][k];
    for (int p = 0; p + 2 <= most; p++)
        for (int k = 0; k < LANES; k++)
            sum[p][k] -= sum[p + 2][k];
}

/* Fit polynomials about `LANES` neighbouring points from moments of weights s and values t; the value and leverage. */
static void solve_lanes(double s[POWERS][LANES], double t[POWERS][LANES], int size, double *fitted, double *leverage)
{
    double a[4][4][LANES], right[4][LANES] = {{0.0}}, smallest = 1e-12;
    for (int k = 0; k < LANES; k++) {
        double ridge = 1e-9 * fmax(s[0][k], smallest);
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++)
                a[i][j][k] = s[i + j][k] + (i == j ? ridge : 0.0);
        right[0][k] = 1.0;
    }
    for (int p = 0; p < size; p++)
        for (int i = p + 1; i < size; i++)
            for (int k = 0; k < LANES; k++) {
                double part = a[i][p][k] / a[p][p][k];
                for (int j = p + 1; j < size; j++)
                    a[i][j][k] -= part * a[p][j][k];
                right[i][k] -= part * right[p][k];
            }
    for (int p = size - 1; p >= 0; p--)
        for (int k = 0; k < LANES; k++) {
            for (int j = p + 1; j < size; j++)
                right[p][k] -= a[p][j][k] * right[j][k];
            right[p][k] /= a[p][p][k];
        }
    for (int k = 0; k < LANES; k++) {
        fitted[k] = 0.0, leverage[k] = right[0][k];
        for (int p = 0; p < size; p++)
            fitted[k] += right[p][k] * t[p][k];
    }
}

/* Fit about the points of a block, by differences of running sums; they are counted from its middle, in units of the
 * window, so that few digits are lost in the differences. */
static void fit_block(const double *value, const double *weight, Py_ssize_t points, Py_ssize_t half, int degree,
                      Py_ssize_t hole, double *room, double *smooth, double *leverage)
{
    int most = 2 * degree + 2, own = degree + 2, rows = most + own + 3;
    Py_ssize_t count = points + 2 * half;
    double unit = 1.0 / (double)(half + 1), middle = 0.5 * (double)(count - 1);
    for (int p = 0; p < rows; p++)
        room[p] = 0.0;
    for (Py_ssize_t i = 0; i < count; i++) {
        const double *before = room + i * rows;
        double *after = room + (i + 1) * rows, u = ((double)i - middle) * unit, w = weight[i], v = w > 0.0 ? value[i] * w : 0.0;
        for (int p = 0; p <= most; p++, w *= u)
            after[p] = before[p] + w;
        for (int p = 0; p <= own; p++, v *= u)
            after[most + 1 + p] = before[most + 1 + p] + v;
        after[rows - 1] = before[rows - 1] + (weight[i] > 0.0 ? 1.0 : 0.0);
    }
    for (Py_ssize_t begin = 0; begin < points; begin += LANES) {
        double s[POWERS][LANES], t[POWERS][LANES], c[LANES], fitted[LANES], own_share[LANES], held[LANES];
        for (int k = 0; k < LANES; k++) {
            Py_ssize_t at = begin + k < points ? begin + k : points - 1;
            const double *low = room + at * rows, *high = room + (at + 2 * half + 1) * rows;
            const double *skip = room + (at + half - hole) * rows, *on = room + (at + half + hole + 1) * rows;
            c[k] = ((double)(at + half) - middle) * unit, held[k] = high[rows - 1] - low[rows - 1];
            for (int p = 0; p <= most; p++)
                s[p][k] = high[p] - low[p] - (hole < 0 ? 0.0 : on[p] - skip[p]);
            for (int p = 0, q = most + 1; p <= own; p++, q++)
                t[p][k] = high[q] - low[q] - (hole < 0 ? 0.0 : on[q] - skip[q]);
        }
        centred(s, c, most);
        centred(t, c, own);
        solve_lanes(s, t, degree + 1, fitted, own_share);
        for (int k = 0; k < LANES && begin + k < points; k++) {
            int enough = held[k] > (double)degree + 2.5;
            smooth[begin + k] = enough ? fitted[k] : NAN;
            leverage[begin + k] = enough ? (hole < 0 ? own_share[k] : 0.0) : NAN;
        }
    }
}

/* local(value, weight, smooth, leverage, half, degree, hole) */
PyObject *loops_local(PyObject *self, PyObject *args)
{
    PyObject *given[4], *done = NULL;
    Py_buffer views[4];
    Arrays arrays = {views, 0};
    Py_ssize_t half, hole;
    double *room = NULL;
    int degree;
    if (!PyArg_ParseTuple(args, "OOOOnin", &given[0], &given[1], &given[2], &given[3], &half, &degree, &hole))
        return NULL;
    Py_buffer *a = take(&arrays, given, "1d1d1D1D");
    if (a == NULL)
        goto end;
    Py_ssize_t count = a[2].shape[0], block = 2 * half + LANES;
    if (half < 1 || half > 1 << 20 || degree < 0 || degree > 3 || hole < -1 || hole >= half || a[3].shape[0] != count ||
        a[0].shape[0] != count + 2 * half || a[1].shape[0] != count + 2 * half) {
        misfit();
        goto end;
    }
    room = PyMem_Calloc((block + 2 * half + 1) * (3 * degree + 7), sizeof(double));
    if (room == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t k = 0; k < count; k += block)
        fit_block((double *)a[0].buf + k, (double *)a[1].buf + k, count - k < block ? count - k : block, half, degree, hole,
                  room, (double *)a[2].buf + k, (double *)a[3].buf + k);
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    PyMem_Free(room);
    give_back(&arrays);
    return done;
}
