/* The inner loops of tracking: `cut` of geometry/grid.py and `fit` of angles/matching.py say what they do.
 *
 * Both have a twin in Python, which is used where this file could not be compiled; tests hold the two together.
 * Only the stable interface of Python 3.11 is used, so that one build serves all later versions.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <math.h>
#include <stdint.h>

#define MOST_ARRAYS 16

/* Arrays that are in use; all are given back together. */
typedef struct {
    Py_buffer *view;
    Py_ssize_t count;
} Arrays;

static void give_back(Arrays *arrays)
{
    while (arrays->count > 0)
        PyBuffer_Release(&arrays->view[--arrays->count]);
}

/* Take an array of so many dimensions and bytes a number; `flags` as for PyObject_GetBuffer. */
static Py_buffer *array(Arrays *arrays, PyObject *object, int ndim, Py_ssize_t itemsize, int flags)
{
    Py_buffer *view = &arrays->view[arrays->count];
    if (object == NULL || PyObject_GetBuffer(object, view, flags) < 0)
        return NULL;
    arrays->count++;
    if (view->ndim == ndim && view->itemsize == itemsize)
        return view;
    PyErr_SetString(PyExc_ValueError, "an array has another shape or type than is expected");
    return NULL;
}

typedef struct {
    const int32_t *at, *box;
    const float *right, *down, *ground;
    float *score;
    Py_ssize_t rows, columns, width, stride;
} Grid;

typedef struct {
    const uint8_t *pixels;
    Py_ssize_t stride;
    float weight;
} Plane;

/* Form the score in the box that a window touches, then sample it. */
static void cut_one(const Grid *grid, const Plane *plane, int planes, Py_ssize_t first, float *out)
{
    const int32_t *edge = grid->box + 4 * first;
    for (int32_t y = edge[2]; y < edge[3]; y++) {
        float *line = grid->score + y * grid->stride;
        const uint8_t *a = plane[0].pixels + y * plane[0].stride;
        if (planes == 2) {
            const uint8_t *b = plane[1].pixels + y * plane[1].stride;
            for (int32_t x = edge[0]; x < edge[1]; x++)
                line[x] = plane[0].weight * (float)a[x] + plane[1].weight * (float)b[x];
        }
        else
            for (int32_t x = edge[0]; x < edge[1]; x++)
                line[x] = plane[0].weight * (float)a[x];
    }
    for (Py_ssize_t row = 0; row < grid->rows; row++) {
        Py_ssize_t begin = row * grid->columns + first;
        const int32_t *at = grid->at + begin;
        const float *right = grid->right + begin, *down = grid->down + begin, *ground = grid->ground + begin;
        for (Py_ssize_t k = 0; k < grid->width; k++) {
            const float *s = grid->score + at[k], *t = s + grid->stride;
            float above = s[0] + right[k] * (s[1] - s[0]);
            float below = t[0] + right[k] * (t[1] - t[0]);
            *out++ = above + down[k] * (below - above) - ground[k];
        }
    }
}

/* cut(planes, weights, at, right, down, box, ground, first, score, out) */
static PyObject *cut(PyObject *self, PyObject *args)
{
    PyObject *given[8], *planes, *done = NULL;
    float weight[2];
    Grid grid;
    if (!PyArg_ParseTuple(args, "O!(ff)OOOOOOOO", &PyTuple_Type, &planes, &weight[0], &weight[1], &given[0], &given[1],
                          &given[2], &given[3], &given[4], &given[5], &given[6], &given[7]))
        return NULL;
    int kinds = (int)PyTuple_Size(planes);
    Py_ssize_t count = kinds < 1 || kinds > 2 ? -1 : PyList_Size(PyTuple_GetItem(planes, 0));
    if (count < 0)
        return PyErr_Occurred() ? NULL : PyErr_Format(PyExc_ValueError, "one or two lists of planes are expected");
    Arrays arrays = {PyMem_Calloc(MOST_ARRAYS + 2 * count, sizeof(Py_buffer)), 0};
    Plane *plane = PyMem_Calloc(2 * count + 1, sizeof(Plane));
    if (arrays.view == NULL || plane == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    Py_buffer *at = array(&arrays, given[0], 2, 4, PyBUF_ND);
    Py_buffer *right = at ? array(&arrays, given[1], 2, 4, PyBUF_ND) : NULL;
    Py_buffer *down = right ? array(&arrays, given[2], 2, 4, PyBUF_ND) : NULL;
    Py_buffer *box = down ? array(&arrays, given[3], 2, 4, PyBUF_ND) : NULL;
    Py_buffer *ground = box ? array(&arrays, given[4], 2, 4, PyBUF_ND) : NULL;
    Py_buffer *first = ground ? array(&arrays, given[5], 1, 8, PyBUF_ND) : NULL;
    Py_buffer *score = first ? array(&arrays, given[6], 2, 4, PyBUF_ND | PyBUF_WRITABLE) : NULL;
    Py_buffer *out = score ? array(&arrays, given[7], 3, 4, PyBUF_ND | PyBUF_WRITABLE) : NULL;
    if (out == NULL)
        goto end;
    grid = (Grid){at->buf, box->buf, right->buf, down->buf, ground->buf, score->buf,
                  out->shape[1], at->shape[1], out->shape[2], score->shape[1]};
    int fits = at->shape[0] == grid.rows && out->shape[0] == count && first->shape[0] == count && box->shape[1] == 4 &&
               right->len == at->len && down->len == at->len && ground->len == at->len;
    for (Py_ssize_t k = 0; fits && k < count; k++) {
        int64_t place = ((int64_t *)first->buf)[k];
        fits = place >= 0 && place < box->shape[0] && place + grid.width <= grid.columns;
        for (int kind = 0; fits && kind < kinds; kind++) {
            Py_buffer *view = array(&arrays, PyList_GetItem(PyTuple_GetItem(planes, kind), k), 2, 1, PyBUF_STRIDES);
            if (view == NULL)
                goto end;
            fits = view->shape[0] == score->shape[0] && view->shape[1] == score->shape[1] && view->strides[1] == 1;
            plane[2 * k + kind] = (Plane){view->buf, view->strides[0], weight[kind]};
        }
    }
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "arrays do not fit each other");
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t k = 0; k < count; k++)
        cut_one(&grid, plane + 2 * k, kinds, (Py_ssize_t)((int64_t *)first->buf)[k],
                (float *)out->buf + k * grid.rows * grid.width);
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    if (arrays.view != NULL)
        give_back(&arrays);
    PyMem_Free(arrays.view);
    PyMem_Free(plane);
    return done;
}

typedef struct {
    const double *curve, *slope; /* padded by `pad` with their end values */
    Py_ssize_t size, pad, rounds;
    double limit, stride, fineness;
} Template;

/* Fit one profile; out: displacement, gain, offset, sum of squares left over, last entry of the inverse. */
static void fit_one(const Template *t, const double *profile, const uint8_t *seen, double shift, double *out)
{
    double gain = 0.0, offset = 0.0, left = 0.0, spread = 0.0;
    shift = fmin(fmax(shift, -t->limit), t->limit);
    for (Py_ssize_t round = 0; round < t->rounds; round++) {
        double place = rint(shift * t->fineness) / t->fineness, whole = floor(-place), part = -place - whole;
        const double *curve = t->curve + t->pad + (Py_ssize_t)whole, *slope = t->slope + t->pad + (Py_ssize_t)whole;
        double cc = 0, c1 = 0, cs = 0, n = 0, s1 = 0, ss = 0, pc = 0, p1 = 0, ps = 0, pp = 0;
        for (Py_ssize_t k = 0; k < t->size; k++) {
            double w = seen[k] ? 1.0 : 0.0, p = w * profile[k];
            double c = curve[k] + part * (curve[k + 1] - curve[k]), s = slope[k] + part * (slope[k + 1] - slope[k]);
            double wc = w * c, ws = w * s;
            cc += wc * c, c1 += wc, cs += wc * s, n += w, s1 += ws, ss += ws * s;
            pc += p * c, p1 += p, ps += p * s, pp += p * p;
        }
        double ridge = 1e-9 * (1.0 + cc + n + ss);
        cc += ridge, n += ridge, ss += ridge;
        double a = n * ss - s1 * s1, b = cs * s1 - c1 * ss, c = c1 * s1 - cs * n;
        double d = cc * ss - cs * cs, e = c1 * cs - s1 * cc, f = cc * n - c1 * c1;
        double determinant = cc * a + c1 * b + cs * c;
        gain = (a * pc + b * p1 + c * ps) / determinant;
        offset = (b * pc + d * p1 + e * ps) / determinant;
        double lean = (c * pc + e * p1 + f * ps) / determinant;
        spread = f / determinant;
        left = pp - gain * pc - offset * p1 - lean * ps;
        double off = fabs(gain) > 1e-3 ? -lean / gain : 0.0;
        shift = place + fmin(fmax(off, -t->stride), t->stride);
        shift = fmin(fmax(shift, -t->limit), t->limit);
        if (rint(shift * t->fineness) / t->fineness == place)
            break;
    }
    out[0] = shift, out[1] = gain, out[2] = offset, out[3] = left, out[4] = spread;
}

/* fit(profile, curve, slope, pad, start, seen, limit, stride, rounds, fineness, out) */
static PyObject *fit(PyObject *self, PyObject *args)
{
    PyObject *given[6], *done = NULL;
    Template t;
    Py_buffer views[6];
    Arrays arrays = {views, 0};
    if (!PyArg_ParseTuple(args, "OOOnOOddndO", &given[0], &given[1], &given[2], &t.pad, &given[3], &given[4], &t.limit,
                          &t.stride, &t.rounds, &t.fineness, &given[5]))
        return NULL;
    Py_buffer *profile = array(&arrays, given[0], 2, 8, PyBUF_ND);
    Py_buffer *curve = profile ? array(&arrays, given[1], 1, 8, PyBUF_ND) : NULL;
    Py_buffer *slope = curve ? array(&arrays, given[2], 1, 8, PyBUF_ND) : NULL;
    Py_buffer *start = slope ? array(&arrays, given[3], 1, 8, PyBUF_ND) : NULL;
    Py_buffer *seen = start ? array(&arrays, given[4], 2, 1, PyBUF_ND) : NULL;
    Py_buffer *out = seen ? array(&arrays, given[5], 2, 8, PyBUF_ND | PyBUF_WRITABLE) : NULL;
    if (out == NULL)
        goto end;
    Py_ssize_t count = profile->shape[0];
    t.size = profile->shape[1], t.curve = curve->buf, t.slope = slope->buf;
    if (curve->shape[0] != t.size + 2 * t.pad || slope->len != curve->len || !(t.limit + 2.0 <= (double)t.pad) ||
        start->shape[0] != count || seen->shape[0] != count || seen->shape[1] != t.size || out->shape[0] != count ||
        out->shape[1] != 5) {
        PyErr_SetString(PyExc_ValueError, "arrays do not fit each other");
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t k = 0; k < count; k++)
        fit_one(&t, (double *)profile->buf + k * t.size, (uint8_t *)seen->buf + k * t.size, ((double *)start->buf)[k],
                (double *)out->buf + 5 * k);
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    give_back(&arrays);
    return done;
}

static PyMethodDef methods[] = {
    {"cut", cut, METH_VARARGS, "Sample windows of a polar grid."},
    {"fit", fit, METH_VARARGS, "Fit a template to profiles."},
    {NULL, NULL, 0, NULL},
};

static int set_edition(PyObject *module)
{
    return PyModule_AddIntConstant(module, "EDITION", 1);
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, set_edition}, {0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "gyrotrack._compiled", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__compiled(void)
{
    return PyModuleDef_Init(&definition);
}
