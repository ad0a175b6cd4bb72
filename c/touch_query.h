/* touch_query.h: the force, its gradient and the vibration of a field at points and times, from frames in the memory of a
   receiver (touch_receiver.h). Nothing is allocated. */
#ifndef TOUCH_QUERY_H
#define TOUCH_QUERY_H

#include "touch_receiver.h"

/* An instant: two frames in the memory that begins at `memory`, and how far it lies on the way from the first to the
   second, 0 to 1. Where one frame alone is shown, both are that frame. */
typedef struct {
    const char *memory;
    const touch_frame_header *before, *after;
    double blend;
} touch_instant;

/* Frames by their offsets; a blend at 0 or 1, or beyond, selects one frame. */
static touch_instant touch_instant_of(const void *memory, int64_t before_offset, int64_t after_offset, double blend);
/* Newtons; zero where the point is not finite. Trilinear in space; the pose of a body is interpolated, and fields that
   differ are blended linearly in that pose. */
static touch_vector touch_force_at(const touch_instant *t, touch_vector point_m);
/* dF_i/dx_j, N/m, by differences from the force at the point to those just ahead. */
static touch_matrix touch_gradient_at(const touch_instant *t, touch_vector point_m, touch_vector force_n);
/* Amplitude, N, and frequency, Hz. */
static void touch_vibration_at(const touch_instant *t, touch_vector point_m, double *amplitude_n, double *frequency_hz);
/* Bodies that both frames have, and the one that pushes most at a point; -1: none. */
static int64_t touch_body_count(const touch_instant *t);
static int64_t touch_strongest_body(const touch_instant *t, touch_vector point_m);
/* Where a body lies: a point x of the body is at R x + position. */
static touch_matrix touch_body_rotation(const touch_instant *t, int64_t body);
static touch_vector touch_body_position(const touch_instant *t, int64_t body);
/* The displacements by which the first frame yields follow a force at a point for dt_s seconds. */
static void touch_yield(touch_receiver *receiver, const touch_instant *t, touch_vector point_m, touch_vector force_n,
                        double dt_s);
/* Force, N, and torque, N m, on the receiver's tool, with the device's point at `point_m`, rotated by
   state.tool_rotation. */
static touch_vector touch_tool_force(touch_receiver *receiver, const touch_instant *t, touch_vector point_m,
                                     touch_vector *torque_nm);

#endif
