/* Kernels of tracking; see kernels.c. */
#ifndef GYROTRACK_KERNELS_H
#define GYROTRACK_KERNELS_H
#include <stddef.h>
#include <stdint.h>

typedef ptrdiff_t ssize;

void gt_likelihood(const double *squares, const double *excess, ssize count, const double *share, ssize shares,
                   double clip, double *room, double *out);

void gt_match(const double *profile, const double *curve, const double *slope, const double *start, const uint8_t *seen,
              ssize count, ssize size, ssize pad, double limit, double stride, ssize rounds, double fineness,
              double *out);

void gt_bands(const float *windows, ssize rows, ssize width, const int64_t *which, ssize count,
              const double *light_of, const double *offset_of, const double *scale_of, const float *mixing, ssize parts,
              int across, float *room, double *found);

void gt_crossings(const double *curves, ssize count, ssize size, ssize first, ssize step, double level,
                  double least, double *out);

void gt_local(const double *value, const double *weight, ssize count, ssize half, int degree, ssize hole,
              double *room, double *smooth, double *leverage);

ssize gt_local_room(ssize half, int degree);

void gt_discs(const uint8_t *pixels, ssize count, ssize side, const double *weight, double radius, float *soft,
              double *few, double *out);

void gt_locate(const float *windows, ssize bytes, ssize count, ssize width, const double *column,
               ssize begin, ssize end, ssize step, ssize half, ssize reach, double *sum, double *out);

void gt_sample(const uint8_t *const *pixels, const ssize *stride, int planes, const float *weight, ssize count,
               const int32_t *at, const float *right, const float *down, const int32_t *box, const float *ground,
               const int64_t *first, float *score, ssize score_stride, ssize rows, ssize columns,
               ssize width, float *out);

void gt_ring(const uint8_t *const *pixels, const ssize *stride, ssize height, ssize width, ssize count,
             const double *centre, const double *turn, const float *radius, ssize rows, const float *direction,
             ssize columns, float *room, uint8_t *out);

void gt_turned(const uint8_t *strips, ssize rows, ssize width, const int64_t *which, const double *ahead,
               const float *light, const int64_t *first, ssize count, ssize columns, float *out);

void gt_sample_sums(const float *strips, ssize step, ssize count, ssize size, const float *picture,
                    const float *weights, double *out);

void gt_frame_sums(const float *strips, ssize step, ssize count, ssize size, const float *picture, const float *weights,
                   float *out);

#endif
