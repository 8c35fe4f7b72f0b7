/* Numerical kernels of tracking, in C without Python. `_kernels.py` checks types and shapes, and contains a NumPy
 * version of each kernel. `_compiled.pyx` calls the kernels without further checks of shapes. */
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>


/* Order statistics */

/* Return the order statistic of a rank, 0 for the minimum; the values are permuted. */
static double ranked(double *values, ssize count, ssize rank)
{
    ssize low = 0, high = count - 1;
    while (low < high) {
        double pivot = values[(low + high) / 2];
        ssize i = low, j = high;
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

/* Return the median; only values near `guess` are sorted if the median is among them. */
static double median(const double *values, ssize count, double guess, double *room)
{
    double low = 0.9 * guess, high = 1.1 * guess;
    ssize below = 0, within = 0, rank = (count - 1) / 2;
    for (ssize k = 0; k < count; k++) {
        below += values[k] < low;
        room[within] = values[k];
        within += values[k] >= low && values[k] <= high;
    }
    if (rank < below || count / 2 >= below + within) {
        below = 0, within = count;
        for (ssize k = 0; k < count; k++)
            room[k] = values[k];
    }
    double middle = ranked(room, within, rank - below);
    return count % 2 ? middle : 0.5 * (middle + ranked(room, within, rank - below + 1));
}

/* Variance inflation */

void gt_likelihood(const double *squares, const double *excess, ssize count, const double *share, ssize shares,
                   double clip, double *room, double *out)
{
    double guess = 0.0;
    for (ssize which = 0; which < shares; which++) {
        double logarithm = 0.0, total = 0.0, product = 1.0;
        for (ssize k = 0; k < count; k++)
            room[k] = squares[k] / (1.0 + share[which] * excess[k]);
        for (ssize k = 0; k < count; k++) {
            product *= 1.0 + share[which] * excess[k];
            if (product > 1e200 || k + 1 == count)
                logarithm += log(product), product = 1.0;
        }
        guess = median(room, count, guess, room + count);
        for (ssize k = 0; k < count; k++)
            total += fmin(room[k], clip * guess);
        out[which] = log(fmax(total / (double)count, 1e-30)) + logarithm / (double)count;
    }
}

/* Profile matching */

typedef struct {
    const double *curve, *slope; /* padded by `pad` with their end values */
    ssize size, pad, rounds;
    double limit, stride, fineness;
} Template;

/* Fit one profile. The results in `out` are displacement, gain, offset, sum of squared residuals, and the last diagonal
 * element of the inverse normal matrix. */
static void fit_one(const Template *t, const double *profile, const uint8_t *seen, double shift, double *out)
{
    double gain = 0.0, offset = 0.0, left = 0.0, spread = 0.0;
    shift = fmin(fmax(shift, -t->limit), t->limit);
    for (ssize round = 0; round < t->rounds; round++) {
        double place = rint(shift * t->fineness) / t->fineness, whole = floor(-place), part = -place - whole;
        const double *curve = t->curve + t->pad + (ssize)whole, *slope = t->slope + t->pad + (ssize)whole;
        double cc = 0, c1 = 0, cs = 0, n = 0, s1 = 0, ss = 0, pc = 0, p1 = 0, ps = 0, pp = 0;
        for (ssize k = 0; k < t->size; k++) {
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

void gt_match(const double *profile, const double *curve, const double *slope, const double *start, const uint8_t *seen,
              ssize count, ssize size, ssize pad, double limit, double stride, ssize rounds, double fineness,
              double *out)
{
    Template t = {curve, slope, size, pad, rounds, limit, stride, fineness};
    for (ssize k = 0; k < count; k++)
        fit_one(&t, profile + k * size, seen + k * size, start[k], out + 5 * k);
}

/* Averages over bands of rows or columns */

void gt_bands(const float *windows, ssize rows, ssize width, const int64_t *which, ssize count,
              const double *light_of, const double *offset_of, const double *scale_of, const float *mixing, ssize parts,
              int across, float *room, double *found)
{
    ssize size = across ? width : rows;
    for (ssize n = 0; n < count; n++) {
        const float *window = windows + which[n] * rows * width;
        const double *light = light_of + n * width;
        double offset = offset_of[n], scale = scale_of[n];
        for (ssize part = 0; part < parts; part++) {
            const float *mix = mixing + part * size;
            ssize first = 0, last = size;
            while (first < last && mix[first] == 0.0f)
                first++;
            while (last > first && mix[last - 1] == 0.0f)
                last--;
            if (!across) {
                memset(room, 0, width * sizeof(float));
                for (ssize row = first; row < last; row++)
                    for (ssize k = 0; k < width; k++)
                        room[k] += mix[row] * window[row * width + k];
                for (ssize k = 0; k < width; k++)
                    *found++ = ((double)room[k] * light[k] - offset) * scale;
                continue;
            }
            for (ssize k = first; k < last; k++)
                room[k] = mix[k] * (float)light[k];
            while (first < last && room[first] == 0.0f)
                first++;
            while (last > first && room[last - 1] == 0.0f)
                last--;
            for (ssize row = 0; row < rows; row++) {
                float s[4] = {0.0f, 0.0f, 0.0f, 0.0f};
                const float *line = window + row * width;
                ssize k = first;
                for (; k + 4 <= last; k += 4)
                    for (int j = 0; j < 4; j++)
                        s[j] += room[k + j] * line[k + j];
                for (; k < last; k++)
                    s[0] += room[k] * line[k];
                *found++ = ((double)(s[0] + s[1] + s[2] + s[3]) - offset) * scale;
            }
        }
    }
}

/* Level crossings */

void gt_crossings(const double *curves, ssize count, ssize size, ssize first, ssize step, double level,
                  double least, double *out)
{
    ssize most = step > 0 ? size - first : first + 1;
    for (ssize n = 0; n < count; n++) {
        const double *curve = curves + n * size + first;
        ssize k = 0;
        while (k < most && !(curve[k * step] < level))
            k++;
        double high = k > 0 && k < most ? curve[(k - 1) * step] : NAN, low = k < most ? curve[k * step] : NAN;
        out[n] = (double)(k - 1) + fmin(fmax((high - level) / fmax(high - low, least), 0.0), 1.0);
        if (k == 0 || k == most)
            out[n] = NAN;
    }
}

/* Local polynomials */

#define LANES 8 /* number of fits that are computed together */
#define POWERS 9 /* powers 0 to 8: twice the degree of a cubic, and 2 for the parabolic weights */

/* Convert sums of w u^p, p = 0 to `most`, to sums of w (u - c)^p, and these to sums with the weights 1 - (u - c)^2. */
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

/* Fit polynomials about `LANES` neighbouring points from moments s of the weights and t of the values. The results are
 * the fitted values and their leverages. */
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

/* Fit about the points of a block, by differences of running sums. Positions are relative to the middle of the block,
 * in units of the window, so that the differences lose few digits. */
static void fit_block(const double *value, const double *weight, ssize points, ssize half, int degree,
                      ssize hole, double *room, double *smooth, double *leverage)
{
    int most = 2 * degree + 2, own = degree + 2, rows = most + own + 3;
    ssize count = points + 2 * half;
    double unit = 1.0 / (double)(half + 1), middle = 0.5 * (double)(count - 1);
    for (int p = 0; p < rows; p++)
        room[p] = 0.0;
    for (ssize i = 0; i < count; i++) {
        const double *before = room + i * rows;
        double *after = room + (i + 1) * rows, u = ((double)i - middle) * unit, w = weight[i], v = w > 0.0 ? value[i] * w : 0.0;
        for (int p = 0; p <= most; p++, w *= u)
            after[p] = before[p] + w;
        for (int p = 0; p <= own; p++, v *= u)
            after[most + 1 + p] = before[most + 1 + p] + v;
        after[rows - 1] = before[rows - 1] + (weight[i] > 0.0 ? 1.0 : 0.0);
    }
    for (ssize begin = 0; begin < points; begin += LANES) {
        double s[POWERS][LANES], t[POWERS][LANES], c[LANES], fitted[LANES], own_share[LANES], held[LANES];
        for (int k = 0; k < LANES; k++) {
            ssize at = begin + k < points ? begin + k : points - 1;
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

void gt_local(const double *value, const double *weight, ssize count, ssize half, int degree, ssize hole,
              double *room, double *smooth, double *leverage)
{
    ssize block = 2 * half + LANES;
    for (ssize k = 0; k < count; k += block)
        fit_block(value + k, weight + k, count - k < block ? count - k : block, half, degree, hole, room, smooth + k,
                  leverage + k);
}

ssize gt_local_room(ssize half, int degree) { return (4 * half + LANES + 1) * (3 * degree + 7); }

/* Centroids of discs */

/* Find a bright disc in the score of one window, in px of the window; NaN where the disc is occluded. */
static void disc_one(const uint8_t *pixels, ssize side, const double *weight, double radius, float *soft, double *few,
                     double *out)
{
    ssize size = side * side, count = 0;
    float a = (float)weight[0], b = (float)weight[1];
    for (ssize k = 0; k < size; k++)
        soft[k] = a * (float)pixels[k] + b * (float)pixels[size + k];
    for (ssize row = 0; row < side; row += 3)
        for (ssize k = 0; k < side; k += 3)
            few[count++] = soft[row * side + k];
    float level = (float)ranked(few, count, (ssize)(0.97 * (double)(count - 1)));
    float ground = (float)ranked(few, count, (ssize)(0.5 * (double)(count - 1)));
    float step = level - ground > 1e-6f ? level - ground : 1e-6f, low = ground + 0.3f * step, scale = 1.0f / (0.4f * step);
    for (ssize k = 0; k < size; k++) {
        float s = (soft[k] - low) * scale;
        s = s < 0.0f ? 0.0f : s;
        soft[k] = s > 1.0f ? 1.0f : s;
    }
    double x = 0.5 * (double)(side - 1), y = x, total = 0.0, reach[3] = {2.2 * radius + 3.0, 1.5 * radius + 1.5, 1.35 * radius + 1.0};
    for (int round = 0; round < 3; round++) {
        double along = 0.0, down = 0.0;
        total = 0.0;
        for (ssize row = 0; row < side; row++) {
            double off = (double)row - y, chord = sqrt(fmax(reach[round] * reach[round] - off * off, 0.0));
            double first = floor(x - chord) + 1.0, last = ceil(x + chord) - 1.0;
            float here = 0.0f, turned = 0.0f;
            if (!(chord > 0.0))
                continue;
            first = fmax(first, 0.0), last = fmin(last, (double)(side - 1));
            for (ssize k = (ssize)first; k <= (ssize)last; k++)
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

void gt_discs(const uint8_t *pixels, ssize count, ssize side, const double *weight, double radius, float *soft,
              double *few, double *out)
{
    for (ssize k = 0; k < count; k++)
        disc_one(pixels + 2 * k * side * side, side, weight, radius, soft, few, out + 2 * k);
}

/* Coarse position of a marker in its window */

void gt_locate(const float *windows, ssize bytes, ssize count, ssize width, const double *column,
               ssize begin, ssize end, ssize step, ssize half, ssize reach, double *sum, double *out)
{
    ssize most = width - 2 * half - 2 * reach - 2, across = 2 * half + 1;
    double share = 1.0 / (double)(((end - begin + step - 1) / step) * across);
    for (ssize n = 0; n < count; n++) {
        const char *window = (const char *)windows + n * bytes;
        sum[0] = 0.0;
        for (ssize k = 0; k < width; k++)
            sum[k + 1] = 0.0;
        for (ssize row = begin; row < end; row += step)
            for (ssize k = 0; k < width; k++)
                sum[k + 1] += (double)((const float *)window)[row * width + k];
        for (ssize k = 0; k < width; k++)
            sum[k + 1] += sum[k];
        double whole = fmin(fmax(floor(column[n]), 0.0), (double)most), part = fmin(fmax(column[n] - whole, 0.0), 1.0);
        const double *from = sum + (ssize)whole;
        ssize top = 0;
        double height = -HUGE_VAL, beside[2];
#define HEIGHT(k) (share * ((1.0 - part) * (from[(k) + across] - from[k]) + part * (from[(k) + across + 1] - from[(k) + 1])))
        for (ssize k = 0; k <= 2 * reach; k++)
            if (HEIGHT(k) > height)
                height = HEIGHT(k), top = k;
        double *found = out + 2 * n;
        found[0] = (double)(top - reach), found[1] = 0.0;
        if (top == 0 || top == 2 * reach)
            continue;
        beside[0] = HEIGHT(top - 1), beside[1] = HEIGHT(top + 1);
        double bend = fmin(beside[0] - 2.0 * height + beside[1], -1e-9);
        found[0] += fmin(fmax(0.5 * (beside[0] - beside[1]) / bend, -0.5), 0.5), found[1] = height;
    }
}
#undef HEIGHT

/* Windows of a polar grid, sampled from the planes of frames */

#if defined(__GNUC__)
#define FETCH(place) __builtin_prefetch(place)
#else
#define FETCH(place) ((void)(place))
#endif
#define LINE 64 /* bytes of a cache line */
#define TOGETHER 64 /* samples that are computed at a time */

typedef struct {
    const uint32_t *at; /* line and column of the pixel above and left of each sample, 16 bits each */
    const int32_t *box;
    const float *right, *down, *ground;
    float *score;
    ssize rows, columns, width, stride;
} Grid;

typedef struct {
    const uint8_t *pixels;
    ssize stride;
    float weight;
} Plane;

/* Compute the score of two planes in the box of pixels that a window covers. */
static void form(const Grid *grid, const Plane *plane, const int32_t *edge)
{
    for (int32_t y = edge[2]; y < edge[3]; y++) {
        float *line = grid->score + y * grid->stride;
        const uint8_t *a = plane[0].pixels + y * plane[0].stride, *b = plane[1].pixels + y * plane[1].stride;
        for (int32_t x = edge[0]; x < edge[1]; x++)
            line[x] = plane[0].weight * (float)a[x] + plane[1].weight * (float)b[x];
    }
}

/* Sample a score, or a plane without weights. The four neighbours of each sample are collected first. */
static void sample(const Grid *grid, const Plane *plane, ssize begin, ssize count, float *out)
{
    const uint32_t *at = grid->at + begin;
    const float *right = grid->right + begin, *down = grid->down + begin, *ground = grid->ground + begin;
    float pair[2 * TOGETHER];
    int32_t a[TOGETHER], b[TOGETHER], c[TOGETHER], d[TOGETHER];
    if (plane != NULL) {
        for (ssize k = 0; k < count; k++) {
            const uint8_t *s = plane->pixels + (at[k] >> 16) * plane->stride + (at[k] & 0xffff), *t = s + plane->stride;
            a[k] = s[0], b[k] = s[1], c[k] = t[0], d[k] = t[1];
        }
        for (ssize k = 0; k < count; k++) {
            float left = (float)a[k] + down[k] * (float)(c[k] - a[k]);
            float beside = (float)b[k] + down[k] * (float)(d[k] - b[k]);
            out[k] = plane->weight * (left + right[k] * (beside - left)) - ground[k];
        }
        return;
    }
    for (ssize k = 0; k < count; k++) {
        const float *s = grid->score + (at[k] >> 16) * grid->stride + (at[k] & 0xffff), *t = s + grid->stride;
        pair[2 * k] = s[0] + down[k] * (t[0] - s[0]);
        pair[2 * k + 1] = s[1] + down[k] * (t[1] - s[1]);
    }
    for (ssize k = 0; k < count; k++)
        out[k] = pair[2 * k] + right[k] * (pair[2 * k + 1] - pair[2 * k]) - ground[k];
}

/* Prefetch the pixels of the next window while the current window is processed. */
static void fetch(const Grid *grid, const Plane *plane, int planes, ssize first)
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

static void cut_one(const Grid *grid, const Plane *plane, int planes, ssize first, float *out)
{
    if (planes == 2)
        form(grid, plane, grid->box + 4 * first);
    for (ssize row = 0; row < grid->rows; row++)
        for (ssize k = 0; k < grid->width; k += TOGETHER) {
            ssize count = grid->width - k < TOGETHER ? grid->width - k : TOGETHER;
            sample(grid, planes == 1 ? plane : NULL, row * grid->columns + first + k, count, out);
            out += count;
        }
}

void gt_sample(const uint8_t *const *pixels, const ssize *stride, int planes, const float *weight, ssize count,
               const int32_t *at, const float *right, const float *down, const int32_t *box, const float *ground,
               const int64_t *first, float *score, ssize score_stride, ssize rows, ssize columns,
               ssize width, float *out)
{
    Grid grid = {(const uint32_t *)at, box, right, down, ground, score, rows, columns, width, score_stride};
    Plane plane[2][2];
    for (ssize k = 0; k <= count; k++) {
        if (k < count)
            for (int kind = 0; kind < planes; kind++)
                plane[k % 2][kind] = (Plane){pixels[2 * k + kind], stride[2 * k + kind], weight[kind]};
        if (0 < k && k < count)
            fetch(&grid, plane[k % 2], planes, (ssize)first[k]);
        if (k > 0)
            cut_one(&grid, plane[(k - 1) % 2], planes, (ssize)first[k - 1], out + (k - 1) * rows * width);
    }
}


/* Rings: sampled from luma, turned with a body, and summed */

void gt_ring(const uint8_t *const *pixels, const ssize *stride, ssize height, ssize width, ssize count,
             const double *centre, const double *turn, const float *radius, ssize rows, const float *direction,
             ssize columns, float *room, uint8_t *out)
{
    const float *cosine = direction, *sine = direction + columns;
    float *right = room, *up = room + columns;
    const float last_x = (float)(width - 1), last_y = (float)(height - 1);
    const int32_t most_x = (int32_t)width - 2, most_y = (int32_t)height - 2;
    for (ssize k = 0; k < count; k++) {
        const float c = (float)turn[2 * k], s = (float)turn[2 * k + 1];
        const float x0 = (float)centre[2 * k], y0 = (float)centre[2 * k + 1];
        for (ssize j = 0; j < columns; j++)
            right[j] = c * cosine[j] - s * sine[j], up[j] = s * cosine[j] + c * sine[j];
        for (ssize row = 0; row < rows; row++)
            for (ssize begin = 0; begin < columns; begin += TOGETHER) {
                const ssize size = columns - begin < TOGETHER ? columns - begin : TOGETHER;
                int32_t column[TOGETHER], line[TOGETHER], a[TOGETHER], b[TOGETHER], p[TOGETHER], q[TOGETHER];
                float beside[TOGETHER], below[TOGETHER];
                for (ssize j = 0; j < size; j++) {
                    float x = x0 + radius[row] * right[begin + j], y = y0 - radius[row] * up[begin + j];
                    x = x > 0.0f ? x : 0.0f, y = y > 0.0f ? y : 0.0f;
                    x = x < last_x ? x : last_x, y = y < last_y ? y : last_y;
                    int32_t i = (int32_t)x, l = (int32_t)y;
                    i = i < most_x ? i : most_x, l = l < most_y ? l : most_y;
                    column[j] = i, line[j] = l, beside[j] = x - (float)i, below[j] = y - (float)l;
                }
                for (ssize j = 0; j < size; j++) {
                    const uint8_t *near = pixels[k] + line[j] * stride[k] + column[j], *far = near + stride[k];
                    a[j] = near[0], b[j] = near[1], p[j] = far[0], q[j] = far[1];
                }
                for (ssize j = 0; j < size; j++) {
                    float above = (float)a[j] + beside[j] * (float)(b[j] - a[j]);
                    float under = (float)p[j] + beside[j] * (float)(q[j] - p[j]);
                    out[j] = (uint8_t)(int32_t)(above + below[j] * (under - above) + 0.5f);
                }
                out += size;
            }
    }
}

void gt_turned(const uint8_t *strips, ssize rows, ssize width, const int64_t *which, const double *ahead,
               const float *light, const int64_t *first, ssize count, ssize columns, float *out)
{
    for (ssize k = 0; k < count; k++) {
        const double shift = 0.5 * (double)(width - columns) + ahead[k];
        const ssize whole = (ssize)floor(shift), same = columns - (ssize)first[k];
        const float part = (float)(shift - (double)whole);
        for (ssize row = 0; row < rows; row++) {
            const uint8_t *seen = strips + ((ssize)which[k] * rows + row) * width + whole;
            const float *begin = light + row * columns, *after = begin + first[k];
            for (ssize j = 0; j < columns; j++)
                out[j] = (float)seen[j] + part * (float)((int32_t)seen[j + 1] - (int32_t)seen[j]);
            for (ssize j = 0; j < same; j++)
                out[j] -= after[j];
            for (ssize j = same; j < columns; j++)
                out[j] -= begin[j - same];
            out += columns;
        }
    }
}

#define LANES 8

void gt_sample_sums(const float *strips, ssize step, ssize count, ssize size, const float *picture,
                    const float *weights, double *out)
{
    const float *w = weights, *x = weights + size, *y = weights + 2 * size, *z = weights + 3 * size;
    for (ssize k = 0; k < count; k++, strips += step, out += 4) {
        float sum[4][LANES] = {{0.0f}};
        ssize j = 0;
        for (; j + LANES <= size; j += LANES)
            for (int i = 0; i < LANES; i++) {
                const float off = strips[j + i] - picture[j + i];
                sum[0][i] += off * w[j + i], sum[1][i] += off * x[j + i], sum[2][i] += off * y[j + i];
                sum[3][i] += off * off * z[j + i];
            }
        for (; j < size; j++) {
            const float off = strips[j] - picture[j];
            sum[0][0] += off * w[j], sum[1][0] += off * x[j], sum[2][0] += off * y[j], sum[3][0] += off * off * z[j];
        }
        for (int each = 0; each < 4; each++) {
            out[each] = 0.0;
            for (int i = 0; i < LANES; i++)
                out[each] += (double)sum[each][i];
        }
    }
}

void gt_frame_sums(const float *strips, ssize step, ssize count, ssize size, const float *picture, const float *weights,
                   float *out)
{
    memset(out, 0, (size_t)(5 * size) * sizeof *out);
    for (ssize k = 0; k < count; k++, strips += step, weights += 4) {
        const float a = weights[0], b = weights[1], c = weights[2], d = weights[3];
        if (a != 0.0f)
            for (ssize j = 0; j < size; j++) {
                const float off = strips[j] - picture[j];
                out[j] += a * off, out[size + j] += a * off * off, out[2 * size + j] += b * off;
                out[3 * size + j] += c * off, out[4 * size + j] += d * off;
            }
    }
}
