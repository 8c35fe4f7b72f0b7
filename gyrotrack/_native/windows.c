/* Windows cut out of the planes of a film: geometry/grid.py. */
#include "loops.h"

#if defined(__GNUC__)
#define FETCH(place) __builtin_prefetch(place)
#else
#define FETCH(place) ((void)(place))
#endif
#define LINE 64 /* bytes that come from memory at once */
#define TOGETHER 64 /* samples taken at a time */

typedef struct {
    const uint32_t *at; /* line and column of the pixel left above each sample, 16 bits each */
    const int32_t *box;
    const float *right, *down, *ground;
    float *score;
    Py_ssize_t rows, columns, width, stride;
} Grid;

typedef struct {
    const uint8_t *pixels;
    Py_ssize_t stride;
    float weight;
} Plane;

/* Form the score of two planes in the box that a window touches. */
static void form(const Grid *grid, const Plane *plane, const int32_t *edge)
{
    for (int32_t y = edge[2]; y < edge[3]; y++) {
        float *line = grid->score + y * grid->stride;
        const uint8_t *a = plane[0].pixels + y * plane[0].stride, *b = plane[1].pixels + y * plane[1].stride;
        for (int32_t x = edge[0]; x < edge[1]; x++)
            line[x] = plane[0].weight * (float)a[x] + plane[1].weight * (float)b[x];
    }
}

/* Sample a score, or one plane as it is; four neighbours a sample are gathered first. */
static void sample(const Grid *grid, const Plane *plane, Py_ssize_t begin, Py_ssize_t count, float *out)
{
    const uint32_t *at = grid->at + begin;
    const float *right = grid->right + begin, *down = grid->down + begin, *ground = grid->ground + begin;
    float pair[2 * TOGETHER];
    int32_t a[TOGETHER], b[TOGETHER], c[TOGETHER], d[TOGETHER];
    if (plane != NULL) {
        for (Py_ssize_t k = 0; k < count; k++) {
            const uint8_t *s = plane->pixels + (at[k] >> 16) * plane->stride + (at[k] & 0xffff), *t = s + plane->stride;
            a[k] = s[0], b[k] = s[1], c[k] = t[0], d[k] = t[1];
        }
        for (Py_ssize_t k = 0; k < count; k++) {
            float left = (float)a[k] + down[k] * (float)(c[k] - a[k]);
            float beside = (float)b[k] + down[k] * (float)(d[k] - b[k]);
            out[k] = plane->weight * (left + right[k] * (beside - left)) - ground[k];
        }
        return;
    }
    for (Py_ssize_t k = 0; k < count; k++) {
        const float *s = grid->score + (at[k] >> 16) * grid->stride + (at[k] & 0xffff), *t = s + grid->stride;
        pair[2 * k] = s[0] + down[k] * (t[0] - s[0]);
        pair[2 * k + 1] = s[1] + down[k] * (t[1] - s[1]);
    }
    for (Py_ssize_t k = 0; k < count; k++)
        out[k] = pair[2 * k] + right[k] * (pair[2 * k + 1] - pair[2 * k]) - ground[k];
}

/* Ask for what the next window needs, while this one is worked on. */
static void fetch(const Grid *grid, const Plane *plane, int planes, Py_ssize_t first)
{
    const int32_t *edge = grid->box + 4 * first;
    for (int32_t y = edge[2]; y < edge[3]; y++)
        for (int kind = 0; kind < planes; kind++) {
            const uint8_t *line = plane[kind].pixels + y * plane[kind].stride;
            for (int32_t x = edge[0]; x < edge[1]; x += LINE)
                FETCH(line + x);
            FETCH(line + edge[1] - 1);
        }
}

static void cut_one(const Grid *grid, const Plane *plane, int planes, Py_ssize_t first, float *out)
{
    if (planes == 2)
        form(grid, plane, grid->box + 4 * first);
    for (Py_ssize_t row = 0; row < grid->rows; row++)
        for (Py_ssize_t k = 0; k < grid->width; k += TOGETHER) {
            Py_ssize_t count = grid->width - k < TOGETHER ? grid->width - k : TOGETHER;
            sample(grid, planes == 1 ? plane : NULL, row * grid->columns + first + k, count, out);
            out += count;
        }
}

/* cut(planes, weights, at, right, down, box, ground, first, score, out) */
PyObject *loops_cut(PyObject *self, PyObject *args)
{
    PyObject *given[8], *planes, *done = NULL;
    float weight[2];
    if (!PyArg_ParseTuple(args, "O!(ff)OOOOOOOO", &PyTuple_Type, &planes, &weight[0], &weight[1], &given[0], &given[1],
                          &given[2], &given[3], &given[4], &given[5], &given[6], &given[7]))
        return NULL;
    int kinds = (int)PyTuple_Size(planes);
    Py_ssize_t count = kinds < 1 || kinds > 2 ? -1 : PyList_Size(PyTuple_GetItem(planes, 0));
    if (count < 0)
        return PyErr_Occurred() ? NULL : PyErr_Format(PyExc_ValueError, "one or two lists of planes are expected");
    Arrays arrays = {PyMem_Calloc(8 + 2 * count, sizeof(Py_buffer)), 0};
    Plane *plane = PyMem_Calloc(2 * count + 1, sizeof(Plane));
    if (arrays.view == NULL || plane == NULL) {
        PyErr_NoMemory();
        goto end;
    }
    Py_buffer *a = take(&arrays, given, "2i2i2i2i2i1d2I3I"), *at = a, *box = a + 3, *first = a + 5, *score = a + 6, *out = a + 7;
    if (a == NULL)
        goto end;
    Grid grid = {at->buf, box->buf, a[1].buf, a[2].buf, a[4].buf, score->buf,
                 out->shape[1], at->shape[1], out->shape[2], score->shape[1]};
    const int64_t *begin = first->buf;
    int fits = at->shape[0] == grid.rows && out->shape[0] == count && first->shape[0] == count && box->shape[1] == 4 &&
               a[1].len == at->len && a[2].len == at->len && a[4].len == at->len;
    for (Py_ssize_t k = 0; fits && k < count; k++) {
        fits = begin[k] >= 0 && begin[k] < box->shape[0] && begin[k] + grid.width <= grid.columns;
        for (int kind = 0; fits && kind < kinds; kind++) {
            PyObject *one = PyList_GetItem(PyTuple_GetItem(planes, kind), k);
            Py_buffer *view = one ? take(&arrays, &one, "s2b") : NULL;
            if (view == NULL)
                goto end;
            fits = view->shape[0] == score->shape[0] && view->shape[1] == score->shape[1];
            plane[2 * k + kind] = (Plane){view->buf, view->strides[0], weight[kind]};
        }
    }
    if (!fits) {
        misfit();
        goto end;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t k = 0; k < count; k++) {
        if (k + 1 < count)
            fetch(&grid, plane + 2 * (k + 1), kinds, (Py_ssize_t)begin[k + 1]);
        cut_one(&grid, plane + 2 * k, kinds, (Py_ssize_t)begin[k], (float *)out->buf + k * grid.rows * grid.width);
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    if (arrays.view != NULL)
        give_back(&arrays);
    PyMem_Free(arrays.view);
    PyMem_Free(plane);
    return done;
}
