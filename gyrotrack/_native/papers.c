/* Papers found in windows: `Strip.beside` of geometry/strip.py. */
#include "loops.h"

/* find(windows, column, out, room, rows, step, half, reach): the columns beside and the score there */
PyObject *loops_find(PyObject *self, PyObject *args)
{
    PyObject *given[4], *done = NULL;
    Py_buffer views[4];
    Arrays arrays = {views, 0};
    Py_ssize_t begin, end, step, half, reach;
    if (!PyArg_ParseTuple(args, "OOOO(nnn)nn", &given[0], &given[1], &given[2], &given[3], &begin, &end, &step, &half, &reach))
        return NULL;
    Py_buffer *windows = take(&arrays, given, "s3i1d2D1D"), *out = windows + 2;
    if (windows == NULL)
        goto end;
    Py_ssize_t count = windows->shape[0], width = windows->shape[2], most = width - 2 * half - 2 * reach - 2;
    const double *column = windows[1].buf;
    double *sum = windows[3].buf;
    if (begin < 0 || end > windows->shape[1] || begin >= end || step < 1 || half < 0 || reach < 1 || most < 0 ||
        windows[1].shape[0] != count || out->shape[0] != count || out->shape[1] != 2 || windows[3].shape[0] != width + 1) {
        misfit();
        goto end;
    }
    Py_ssize_t across = 2 * half + 1;
    double share = 1.0 / (double)(((end - begin + step - 1) / step) * across);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t n = 0; n < count; n++) {
        const char *window = (const char *)windows->buf + n * windows->strides[0];
        sum[0] = 0.0;
        for (Py_ssize_t k = 0; k < width; k++)
            sum[k + 1] = 0.0;
        for (Py_ssize_t row = begin; row < end; row += step)
            for (Py_ssize_t k = 0; k < width; k++)
                sum[k + 1] += (double)((const float *)window)[row * width + k];
        for (Py_ssize_t k = 0; k < width; k++)
            sum[k + 1] += sum[k];
        double whole = fmin(fmax(floor(column[n]), 0.0), (double)most), part = fmin(fmax(column[n] - whole, 0.0), 1.0);
        const double *from = sum + (Py_ssize_t)whole;
        Py_ssize_t top = 0;
        double height = -HUGE_VAL, beside[2];
#define HEIGHT(k) (share * ((1.0 - part) * (from[(k) + across] - from[k]) + part * (from[(k) + across + 1] - from[(k) + 1])))
        for (Py_ssize_t k = 0; k <= 2 * reach; k++)
            if (HEIGHT(k) > height)
                height = HEIGHT(k), top = k;
        double *found = (double *)out->buf + 2 * n;
        found[0] = (double)(top - reach), found[1] = 0.0;
        if (top == 0 || top == 2 * reach)
            continue;
        beside[0] = HEIGHT(top - 1), beside[1] = HEIGHT(top + 1);
        double bend = fmin(beside[0] - 2.0 * height + beside[1], -1e-9);
        found[0] += fmin(fmax(0.5 * (beside[0] - beside[1]) / bend, -0.5), 0.5), found[1] = height;
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    give_back(&arrays);
    return done;
}
