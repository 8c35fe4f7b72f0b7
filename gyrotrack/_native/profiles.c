/* Profiles fitted: angles/matching.py. */
#include "loops.h"

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
PyObject *loops_fit(PyObject *self, PyObject *args)
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
