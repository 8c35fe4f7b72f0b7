# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, embedsignature=True
"""Bindings of kernels.c. Types and shapes are checked by `_kernels.py`; a wrong element type is refused here, too."""

from libc.stdint cimport int32_t, int64_t, uint8_t
from libc.stdlib cimport calloc, free

cdef extern from "kernels.h" nogil:
    ctypedef Py_ssize_t ssize
    void gt_likelihood(const double *, const double *, ssize, const double *, ssize, double, double *, double *)
    void gt_match(const double *, const double *, const double *, const double *, const uint8_t *, ssize, ssize, ssize,
                  double, double, ssize, double, double *)
    void gt_bands(const float *, ssize, ssize, const int64_t *, ssize, const double *, const double *, const double *,
                  const float *, ssize, int, float *, double *)
    void gt_crossings(const double *, ssize, ssize, ssize, ssize, double, double, double *)
    void gt_local(const double *, const double *, ssize, ssize, int, ssize, double *, double *, double *)
    ssize gt_local_room(ssize, int)
    void gt_discs(const uint8_t *, ssize, ssize, const double *, double, float *, double *, double *)
    void gt_locate(const float *, ssize, ssize, ssize, const double *, ssize, ssize, ssize, ssize, ssize, double *, double *)
    void gt_sample(const uint8_t **, const ssize *, int, const float *, ssize, const int32_t *, const float *,
                   const float *, const int32_t *, const float *, const int64_t *, float *, ssize, ssize, ssize, ssize, float *)
    void gt_ring(const uint8_t **, const ssize *, ssize, ssize, ssize, const double *, const double *, const float *, ssize,
                 const float *, ssize, float *, uint8_t *)
    void gt_turned(const uint8_t *, ssize, ssize, const int64_t *, const double *, const float *, const int64_t *, ssize, ssize,
                   float *)
    void gt_sample_sums(const float *, ssize, ssize, ssize, const float *, const float *, double *)
    void gt_frame_sums(const float *, ssize, ssize, ssize, const float *, const float *, float *)

ABI = 7


cdef void *_allocated(size_t count, size_t size) except NULL:
    cdef void *room = calloc(count if count else 1, size)
    if room == NULL:
        raise MemoryError
    return room


def likelihood(const double[::1] squares, const double[::1] excess, const double[::1] shares, double clip, double[::1] out):
    cdef ssize count = squares.shape[0]
    cdef double *room = <double *> _allocated(2 * count, sizeof(double))
    with nogil:
        gt_likelihood(&squares[0], &excess[0], count, &shares[0], shares.shape[0], clip, room, &out[0])
    free(room)


def match(const double[:, ::1] profile, const double[::1] curve, const double[::1] slope, const double[::1] start,
          const uint8_t[:, ::1] seen, ssize pad, double limit, double stride, ssize rounds, double fineness, double[:, ::1] out):
    with nogil:
        if profile.shape[0]:
            gt_match(&profile[0, 0], &curve[0], &slope[0], &start[0], &seen[0, 0], profile.shape[0], profile.shape[1], pad,
                     limit, stride, rounds, fineness, &out[0, 0])


def bands(const float[:, :, ::1] windows, const int64_t[::1] which, const double[:, ::1] light, const double[::1] offset,
          const double[::1] scale, const float[:, ::1] mixing, bint across, double[:, :, ::1] out):
    cdef float *room = <float *> _allocated(windows.shape[2] + 4, sizeof(float))
    with nogil:
        if which.shape[0]:
            gt_bands(&windows[0, 0, 0], windows.shape[1], windows.shape[2], &which[0], which.shape[0], &light[0, 0],
                     &offset[0], &scale[0], &mixing[0, 0], mixing.shape[0], across, room, &out[0, 0, 0])
    free(room)


def crossings(const double[:, :, ::1] curves, ssize first, ssize step, double level, double least, double[:, ::1] out):
    with nogil:
        if out.shape[0] and out.shape[1]:
            gt_crossings(&curves[0, 0, 0], out.shape[0] * out.shape[1], curves.shape[2], first, step, level, least, &out[0, 0])


def local_polynomials(const double[::1] value, const double[::1] weight, ssize half, int degree, ssize hole,
                      double[::1] smooth, double[::1] leverage):
    cdef double *room = <double *> _allocated(gt_local_room(half, degree), sizeof(double))
    with nogil:
        if smooth.shape[0]:
            gt_local(&value[0], &weight[0], smooth.shape[0], half, degree, hole, room, &smooth[0], &leverage[0])
    free(room)


def discs(const uint8_t[:, :, :, ::1] pixels, (double, double) weights, double radius, double[:, ::1] out):
    cdef ssize side = pixels.shape[2]
    cdef double[2] weight = [weights[0], weights[1]]
    cdef double *few = <double *> _allocated(side * side, sizeof(double))
    cdef float *soft = <float *> _allocated(side * side, sizeof(float))
    with nogil:
        if pixels.shape[0]:
            gt_discs(&pixels[0, 0, 0, 0], pixels.shape[0], side, weight, radius, soft, few, &out[0, 0])
    free(few)
    free(soft)


def locate(const float[:, :, ::1] windows, const double[::1] column, (ssize, ssize, ssize) rows, ssize half, ssize reach,
           double[:, ::1] out):
    cdef ssize begin = rows[0], end = rows[1], step = rows[2]
    cdef double *room = <double *> _allocated(windows.shape[2] + 1, sizeof(double))
    with nogil:
        if windows.shape[0]:
            gt_locate(&windows[0, 0, 0], windows.strides[0], windows.shape[0], windows.shape[2], &column[0], begin, end, step,
                      half, reach, room, &out[0, 0])
    free(room)


def sample(tuple planes, (float, float) weights, const int32_t[:, ::1] at, const float[:, ::1] right,
           const float[:, ::1] down, const int32_t[:, ::1] box, const float[:, ::1] ground, const int64_t[::1] first,
           float[:, ::1] score, float[:, :, ::1] out):
    cdef ssize count = first.shape[0], k
    cdef int kinds = <int> len(planes), kind
    cdef float[2] weight = [weights[0], weights[1]]
    cdef const uint8_t[:, :] plane
    cdef const uint8_t **pixels = <const uint8_t **> _allocated(2 * count, sizeof(void *))
    cdef ssize *stride = <ssize *> _allocated(2 * count, sizeof(ssize))
    cdef list views = []  # the planes stay alive and in place while the kernel reads them
    try:
        for k in range(count):
            for kind in range(kinds):
                plane = planes[kind][k]
                views.append(plane)
                pixels[2 * k + kind] = &plane[0, 0]
                stride[2 * k + kind] = plane.strides[0]
        with nogil:
            if count:
                gt_sample(pixels, stride, kinds, weight, count, &at[0, 0], &right[0, 0], &down[0, 0], &box[0, 0],
                          &ground[0, 0], &first[0], &score[0, 0], score.shape[1], out.shape[1], at.shape[1], out.shape[2],
                          &out[0, 0, 0])
    finally:
        free(<void *> pixels)
        free(stride)


def ring(list planes, const double[:, ::1] centre, const double[:, ::1] turn, const float[::1] radius,
         const float[:, ::1] direction, uint8_t[:, :, ::1] out):
    cdef ssize count = len(planes), columns = direction.shape[1], k
    cdef const uint8_t[:, :] plane
    cdef const uint8_t **pixels = <const uint8_t **> _allocated(count, sizeof(void *))
    cdef ssize *stride = <ssize *> _allocated(count, sizeof(ssize))
    cdef float *room = <float *> _allocated(2 * columns, sizeof(float))
    cdef ssize height = 0, width = 0
    cdef list views = []  # the planes stay alive and in place while the kernel reads them
    try:
        for k in range(count):
            plane = planes[k]
            views.append(plane)
            pixels[k] = &plane[0, 0]
            stride[k] = plane.strides[0]
            height, width = plane.shape[0], plane.shape[1]
        with nogil:
            if count and out.shape[1] and columns:
                gt_ring(pixels, stride, height, width, count, &centre[0, 0], &turn[0, 0], &radius[0], out.shape[1],
                        &direction[0, 0], columns, room, &out[0, 0, 0])
    finally:
        free(<void *> pixels)
        free(stride)
        free(room)


def turned(const uint8_t[:, :, ::1] strips, const int64_t[::1] which, const double[::1] ahead, const float[:, ::1] light,
           const int64_t[::1] first, float[:, :, ::1] out):
    with nogil:
        if out.shape[0] and out.shape[1] and out.shape[2]:
            gt_turned(&strips[0, 0, 0], strips.shape[1], strips.shape[2], &which[0], &ahead[0], &light[0, 0], &first[0],
                      out.shape[0], out.shape[2], &out[0, 0, 0])


def sample_sums(const float[:, :, ::1] strips, ssize row, const float[::1] picture, const float[:, ::1] weights,
                double[:, ::1] out):
    with nogil:
        if out.shape[0] and picture.shape[0]:
            gt_sample_sums(&strips[0, row, 0], strips.shape[1] * strips.shape[2], strips.shape[0], picture.shape[0], &picture[0],
                           &weights[0, 0], &out[0, 0])


def frame_sums(const float[:, :, ::1] strips, ssize row, const float[::1] picture, const float[:, ::1] weights,
               float[:, ::1] out):
    with nogil:
        if strips.shape[0] and picture.shape[0]:
            gt_frame_sums(&strips[0, row, 0], strips.shape[1] * strips.shape[2], strips.shape[0], picture.shape[0], &picture[0],
                          &weights[0, 0], &out[0, 0])
