/* Windows averaged over bands: geometry/bands.py; and where curves end: geometry/corners.py. */
#include "loops.h"

/* bands(windows, which, light, offset, scale, mixing, out, across) */
PyObject *loops_bands(PyObject *self, PyObject *args)
{
    PyObject *given[7], *done = NULL;
    Py_buffer views[7];
    Arrays arrays = {views, 0};
    float *room = NULL;
    int across;
    if (!PyArg_ParseTuple(args, "OOOOOOOp", &given[0], &given[1], &given[2], &given[3], &given[4], &given[5], &given[6],
                          &across))
        return NULL;
    Py_buffer *a = take(&arrays, given, "3i1d2d1d1d2i3D"), *out = a + 6;
    if (a == NULL)
        goto end;
    Py_ssize_t rows = a->shape[1], width = a->shape[2], count = a[1].shape[0], parts = a[5].shape[0], size = a[5].shape[1];
    const int64_t *which = a[1].buf;
    const float *mixing = a[5].buf;
    int fits = size == (across ? width : rows) && a[2].shape[0] == count && a[2].shape[1] == width &&
               a[3].shape[0] == count && a[4].shape[0] == count && out->shape[0] == count &&
               out->shape[1] == parts && out->shape[2] == (across ? rows : width);
    for (Py_ssize_t k = 0; fits && k < count; k++)
        fits = which[k] >= 0 && which[k] < a->shape[0];
    room = fits ? PyMem_Calloc(width + 4, sizeof(float)) : NULL;
    if (room == NULL) {
        fits ? PyErr_NoMemory() : misfit();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    double *found = out->buf;
    for (Py_ssize_t n = 0; n < count; n++) {
        const float *window = (const float *)a->buf + which[n] * rows * width;
        const double *light = (const double *)a[2].buf + n * width;
        double offset = ((double *)a[3].buf)[n], scale = ((double *)a[4].buf)[n];
        for (Py_ssize_t part = 0; part < parts; part++) {
            const float *mix = mixing + part * size;
            Py_ssize_t first = 0, last = size;
            while (first < last && mix[first] == 0.0f)
                first++;
            while (last > first && mix[last - 1] == 0.0f)
                last--;
            if (!across) {
                memset(room, 0, width * sizeof(float));
                for (Py_ssize_t row = first; row < last; row++)
                    for (Py_ssize_t k = 0; k < width; k++)
                        room[k] += mix[row] * window[row * width + k];
                for (Py_ssize_t k = 0; k < width; k++)
                    *found++ = ((double)room[k] * light[k] - offset) * scale;
                continue;
            }
            for (Py_ssize_t k = first; k < last; k++)
                room[k] = mix[k] * (float)light[k];
            while (first < last && room[first] == 0.0f)
                first++;
            while (last > first && room[last - 1] == 0.0f)
                last--;
            for (Py_ssize_t row = 0; row < rows; row++) {
                float s[4] = {0.0f, 0.0f, 0.0f, 0.0f};
                const float *line = window + row * width;
                Py_ssize_t k = first;
                for (; k + 4 <= last; k += 4)
                    for (int j = 0; j < 4; j++)
                        s[j] += room[k + j] * line[k + j];
                for (; k < last; k++)
                    s[0] += room[k] * line[k];
                *found++ = ((double)(s[0] + s[1] + s[2] + s[3]) - offset) * scale;
            }
        }
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    PyMem_Free(room);
    give_back(&arrays);
    return done;
}

/* crossing(curves, out, first, step, level, least) */
PyObject *loops_crossing(PyObject *self, PyObject *args)
{
    PyObject *given[2], *done = NULL;
    Py_buffer views[2];
    Arrays arrays = {views, 0};
    Py_ssize_t first, step;
    double level, least;
    if (!PyArg_ParseTuple(args, "OOnndd", &given[0], &given[1], &first, &step, &level, &least))
        return NULL;
    Py_buffer *curves = take(&arrays, given, "3d2D"), *out = curves + 1;
    if (curves == NULL)
        goto end;
    Py_ssize_t count = out->shape[0] * out->shape[1], size = curves->shape[2];
    if (curves->shape[0] != out->shape[0] || curves->shape[1] != out->shape[1] || first < 0 || first >= size ||
        (step != 1 && step != -1)) {
        misfit();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    Py_ssize_t most = step > 0 ? size - first : first + 1;
    for (Py_ssize_t n = 0; n < count; n++) {
        const double *curve = (const double *)curves->buf + n * size + first;
        Py_ssize_t k = 0;
        while (k < most && !(curve[k * step] < level))
            k++;
        double high = k > 0 && k < most ? curve[(k - 1) * step] : NAN, low = k < most ? curve[k * step] : NAN;
        ((double *)out->buf)[n] = (double)(k - 1) + fmin(fmax((high - level) / fmax(high - low, least), 0.0), 1.0);
        if (k == 0 || k == most)
            ((double *)out->buf)[n] = NAN;
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    give_back(&arrays);
    return done;
}
