/* touch_log.h: the row that each tick leaves in the log, a ring. */
#ifndef TOUCH_LOG_H
#define TOUCH_LOG_H

#include "touch_receiver.h"
#include "touch_shared.h"

static inline int64_t touch_flags(const touch_clock *clock, int is_silent, int is_stopping) {
    static const int64_t feed_flags[] = {0, TOUCH_FLAG_WAITING, TOUCH_FLAG_RUNNING, TOUCH_FLAG_STALLED, TOUCH_FLAG_ENDED};
    int64_t flags = clock->feed >= TOUCH_READY && clock->feed <= TOUCH_ENDED ? feed_flags[clock->feed] : 0;
    if (is_stopping) flags |= TOUCH_FLAG_STOPPING;
    if (is_silent) flags |= TOUCH_FLAG_SILENT;
    if (clock->mode == TOUCH_PAUSED) flags |= TOUCH_FLAG_PAUSED;
    return flags;
}

static inline void touch_write_row(touch_receiver *receiver, double clock_s, touch_vector force_n, int64_t flags) {
    const touch_tick_state *state = &receiver->state;
    const touch_receiver_layout *layout = &receiver->layout;
    if (layout->log_rows <= 0) return;
    touch_log_row *rows = (touch_log_row *)((char *)receiver + layout->log_offset);
    touch_log_row *row = rows + receiver->clock.log_written % layout->log_rows;
    row->time_s = clock_s;
    row->media_s = receiver->clock.media_s;
    row->position_m = state->position_m;
    row->velocity_m_s = state->velocity_m_s;
    row->field_force_n = state->field_force_n;
    row->friction_n = state->friction_n;
    row->force_n = force_n;
    row->flags = flags;
    for (int n = 0; n < 4; n++) row->orientation[n] = receiver->grip.orientation[n];
    row->field_torque_nm = state->field_torque_nm;
    row->torque_nm = state->torque.output;
    row->buttons = receiver->grip.buttons;
    row->gripper_m = receiver->grip.gripper_m;
    TOUCH_FENCE();
    touch_share(&receiver->clock.log_written, receiver->clock.log_written + 1);
}

#endif
