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
#include <string.h>

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

/* Take arrays as `kinds` says, two letters each: dimensions; b, i, d for 1, 4, 8 bytes a number, capital where they
 * are written to. All are dense, but where the first dimension is in steps ("s" before). */
static Py_buffer *take(Arrays *arrays, PyObject **given, const char *kinds)
{
    Py_ssize_t first = arrays->count;
    for (; *kinds; kinds += 2, given++) {
        int stepped = *kinds == 's';
        kinds += stepped;
        int ndim = kinds[0] - '0', writable = kinds[1] < 'a', letter = kinds[1] | 32;
        Py_ssize_t itemsize = letter == 'b' ? 1 : letter == 'i' ? 4 : 8;
        Py_buffer *view = &arrays->view[arrays->count];
        if (PyObject_GetBuffer(*given, view, (stepped ? PyBUF_STRIDES : PyBUF_ND) | (writable ? PyBUF_WRITABLE : 0)) < 0)
            return NULL;
        arrays->count++;
        int fits = view->ndim == ndim && view->itemsize == itemsize;
        for (Py_ssize_t dense = itemsize, k = ndim - 1; fits && stepped && k > 0; dense *= view->shape[k--])
            fits = view->strides[k] == dense;
        if (!fits) {
            PyErr_SetString(PyExc_ValueError, "an array has another shape or type than is expected");
            return NULL;
        }
    }
    return arrays->view + first;
}

static PyObject *misfit(void)
{
    PyErr_SetString(PyExc_ValueError, "arrays do not fit each other");
    return NULL;
}

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
static PyObject *cut(PyObject *self, PyObject *args)
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

/* fit(profile, curve, slope, start, seen, out, pad, limit, stride, rounds, fineness) */
static PyObject *fit(PyObject *self, PyObject *args)
{
    PyObject *given[6], *done = NULL;
    Template t;
    Py_buffer views[6];
    Arrays arrays = {views, 0};
    if (!PyArg_ParseTuple(args, "OOOOOOnddnd", &given[0], &given[1], &given[2], &given[3], &given[4], &given[5], &t.pad,
                          &t.limit, &t.stride, &t.rounds, &t.fineness))
        return NULL;
    Py_buffer *profile = take(&arrays, given, "2d1d1d1d2b2D"), *start = profile + 3, *seen = profile + 4, *out = profile + 5;
    if (profile == NULL)
        goto end;
    Py_ssize_t count = profile->shape[0];
    t.size = profile->shape[1], t.curve = profile[1].buf, t.slope = profile[2].buf;
    if (profile[1].shape[0] != t.size + 2 * t.pad || profile[2].len != profile[1].len ||
        !(t.limit + 2.0 <= (double)t.pad) || start->shape[0] != count || seen->shape[0] != count ||
        seen->shape[1] != t.size || out->shape[0] != count || out->shape[1] != 5) {
        misfit();
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

/* The value of a rank, 0 for the least; values change places. */
static double ranked(double *values, Py_ssize_t count, Py_ssize_t rank)
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

/* The median; `near` is where it may be, so that only what lies there is put in order. */
static double median(const double *values, Py_ssize_t count, double near, double *room)
{
    double low = 0.9 * near, high = 1.1 * near;
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

/* unlikely(squares, odd, shares, out, fault): see angles/oddity.py */
static PyObject *unlikely(PyObject *self, PyObject *args)
{
    PyObject *given[4], *done = NULL;
    double fault, near = 0.0, *room = NULL;
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
        near = median(room, count, near, room + count);
        for (Py_ssize_t k = 0; k < count; k++)
            total += fmin(room[k], fault * near);
        ((double *)a[3].buf)[which] = log(fmax(total / (double)count, 1e-30)) + logarithm / (double)count;
    }
    Py_END_ALLOW_THREADS
    done = Py_NewRef(Py_None);
end:
    PyMem_Free(room);
    give_back(&arrays);
    return done;
}

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

/* disc(pixels, out, weights, radius): see geometry/disc.py */
static PyObject *disc(PyObject *self, PyObject *args)
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

/* near(windows, column, out, room, rows, step, half, reach): see `Strip.beside` of geometry/strip.py */
static PyObject *near(PyObject *self, PyObject *args)
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

/* bands(windows, which, light, offset, scale, mixing, out, across): see geometry/bands.py */
static PyObject *bands(PyObject *self, PyObject *args)
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

/* local(value, weight, smooth, leverage, half, degree, hole): see geometry/local.py */
static PyObject *local(PyObject *self, PyObject *args)
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

/* crossing(curves, out, first, step, level): see geometry/corners.py */
static PyObject *crossing(PyObject *self, PyObject *args)
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

static PyMethodDef methods[] = {
    {"cut", cut, METH_VARARGS, "Sample windows of a polar grid."},
    {"near", near, METH_VARARGS, "Find papers in windows."},
    {"fit", fit, METH_VARARGS, "Fit a template to profiles."},
    {"bands", bands, METH_VARARGS, "Average windows over bands of rows or columns."},
    {"crossing", crossing, METH_VARARGS, "Find where curves fall below a level."},
    {"local", local, METH_VARARGS, "Fit polynomials about the points of a series."},
    {"disc", disc, METH_VARARGS, "Find discs."},
    {"unlikely", unlikely, METH_VARARGS, "Weigh how unlikely residuals are."},
    {NULL, NULL, 0, NULL},
};

static int set_edition(PyObject *module)
{
    return PyModule_AddIntConstant(module, "EDITION", 4);
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, set_edition}, {0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "gyrotrack._compiled", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__compiled(void)
{
    return PyModuleDef_Init(&definition);
}
