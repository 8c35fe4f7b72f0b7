/* Discs found in windows: geometry/disc.py. */
#include "loops.h"

/* Find a bright disc in the score of one window, in px of it; NaN where it is hidden. */
static void disc_one(const uint8_t *pixels, Py_ssize_t side, const double *weight, double radius, float *soft, double *few,
                     double *out)
{
    Py_ssize_t size = side * side, count = 0;
    float a = (float)weight[0], b = (float)weight[1];
    for (Py_ssize_t k = 0; k < size; k++)
        soft[k] = a * (float)pixels[k] + b * (float)pixels[size + k];
    for (Py_ssize_t row = 0; row < side; row += 3)
        for (Py_ssize_t k = 0; k < side; k += 3)
            few[count++] = soft[row * side + k];
    float level = (float)ranked(few, count, (Py_ssize_t)(0.97 * (double)(count - 1)));
    float ground = (float)ranked(few, count, (Py_ssize_t)(0.5 * (double)(count - 1)));
    float step = level - ground > 1e-6f ? level - ground : 1e-6f, low = ground + 0.3f * step, scale = 1.0f / (0.4f * step);
    for (Py_ssize_t k = 0; k < size; k++) {
        float s = (soft[k] - low) * scale;
        s = s < 0.0f ? 0.0f : s;
        soft[k] = s > 1.0f ? 1.0f : s;
    }
    double x = 0.5 * (double)(side - 1), y = x, total = 0.0, reach[3] = {2.2 * radius + 3.0, 1.5 * radius + 1.5, 1.35 * radius + 1.0};
    for (int round = 0; round < 3; round++) {
        double along = 0.0, down = 0.0;
        total = 0.0;
        for (Py_ssize_t row = 0; row < side; row++) {
            double off = (double)row - y, chord = sqrt(fmax(reach[round] * reach[round] - off * off, 0.0));
            double first = floor(x - chord) + 1.0, last = ceil(x + chord) - 1.0;
            float here = 0.0f, turned = 0.0f;
            if (!(chord > 0.0))
                continue;
            first = fmax(first, 0.0), last = fmin(last, (double)(side - 1));
            for (Py_ssize_t k = (Py_ssize_t)first; k <= (Py_ssize_t)last; k++)
                here += soft[row * side + k], turned += soft[row * side + k] * (float)k;
            total += here, along += turned, down += (double)here * (double)row;
        }
        total = fmax(total, 1e-9);
        x = along / total, y = down / total;
    }
    double expected = 3.14159265358979323846 * radius * radius;
    int hidden = total < 0.6 * expected || total > 1.7 * expected || step < 0.3f;
    out[0] = hidden ? NAN : x, out[1] = hidden ? NAN : y;
}

/* disc(pixels, out, weights, radius) */
PyObject *loops_disc(PyObject *self, PyObject *args)
{
    PyObject *given[2], *done = NULL;
    double weight[2], radius, *few = NULL;
    Py_buffer views[2];
    Arrays arrays = {views, 0};
    if (!PyArg_ParseTuple(args, "OO(dd)d", &given[0], &given[1], &weight[0], &weight[1], &radius))
        return NULL;
    Py_buffer *pixels = take(&arrays, given, "4b2D"), *out = pixels + 1;
    if (pixels == NULL)
        goto end;
    Py_ssize_t count = pixels->shape[0], side = pixels->shape[2];
    if (side < 1 || pixels->shape[1] != 2 || pixels->shape[3] != side || out->shape[0] != count || out->shape[1] != 2) {
        misfit();
        goto end;
    }
    few = PyMem_Calloc(side * side, sizeof(double) + sizeof(float));
    if (few == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t k = 0; k < count; k++)
        disc_one((uint8_t *)pixels->buf + 2 * k * side * side, side, weight, radius, (float *)(few + side * side), few,
                 (double *)out->buf + 2 * k);
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    PyMem_Free(few);
    give_back(&arrays);
    return done;
}
