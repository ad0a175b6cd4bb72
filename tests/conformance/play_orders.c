/* Checks of c/touch_play.h on a clock of its own: play_orders CHECK FILE.touch X Y Z, a point with a force, metres. 0 if all
   hold; else prints the first that does not. CHECK: stop, what an order after a stop does; silence, a thread that decodes no
   more; force-max, the greatest force of a device. */
#define TOUCH_IMPLEMENTATION
#include "touch_play.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition) \
    if (!(condition)) return printf("line %d: %s\n", __LINE__, #condition), 1

static touch_play play;
static void *memory;
static uint8_t file[1 << 22];
static size_t file_size;
static touch_vector hand_m, force_n;
static int64_t clock_ns;
static int is_slow; /* each force so far was within peak and slew limit */

static int start(int is_loop, double force_max_n) {
    touch_device device = {force_max_n, 0, 0, 0, 0, 0, 0, 0, 0};
    free(memory), memory = NULL, force_n = touch_zero(), is_slow = 1;
    if (touch_play_open(&play, file, file_size, &device)) return 0;
    play.options.is_loop = is_loop, play.options.log_rows = 4;
    memory = malloc(touch_play_room(&play));
    return touch_play_start(&play, memory) == TOUCH_OK;
}

/* Ticks of 1 ms; before each, the other thread decodes all it can, or is silent. */
static void tick(int count, int has_decoder) {
    for (; count > 0; count--, clock_ns += 1000000) {
        while (has_decoder && touch_play_decode(&play)) {}
        touch_vector before_n = force_n;
        force_n = touch_receiver_tick(play.receiver, hand_m, clock_ns);
        double step_n = touch_norm(touch_subtract(force_n, before_n));
        const touch_limits *limits = &play.receiver->settings.force_limits;
        is_slow &= touch_norm(force_n) <= limits->peak && step_n <= 1e-3 * limits->slew_per_s + 1e-12;
    }
}

static void order(int kind) {
    if (kind == 0) touch_play_resume(&play);
    if (kind == 1) touch_play_pause(&play);
    if (kind == 2) touch_play_seek(&play, 0.0);
    if (kind == 3) touch_give_order(play.receiver, play.receiver->orders.generation, 0.0, 1.0, TOUCH_PLAYING, 0);
    if (kind == 4) play.receiver->orders.is_stopping = 0, play.receiver->orders.sequence += 2; /* another program's order */
}

static int check_stop(void) {
    for (int kind = 0; kind < 5; kind++)
        for (int is_at_once = 0; is_at_once < 2 - (kind == 4); is_at_once++) {
            CHECK(start(1, 0.5));
            touch_play_resume(&play);
            tick(200, 1);
            CHECK(!touch_is_zero(force_n));
            touch_play_stop(&play);
            tick(is_at_once ? 0 : 2, 1); /* at once: the servo sees the second order only */
            order(kind);
            tick(200, 1);
            CHECK(touch_is_zero(force_n) && play.receiver->clock.is_released);
            order(kind);
            tick(200, 1);
            CHECK(touch_is_zero(force_n) && is_slow);
        }
    CHECK(start(1, 0.5)); /* a new receiver in the same memory has not been stopped */
    touch_play_resume(&play);
    tick(200, 1);
    CHECK(!touch_is_zero(force_n));
    return 0;
}

static int64_t latest_flags(void) {
    const touch_receiver *receiver = play.receiver;
    const touch_log_row *rows = (const touch_log_row *)(const void *)((const char *)receiver + receiver->layout.log_offset);
    return rows[(receiver->clock.log_written - 1) % receiver->layout.log_rows].flags;
}

static int check_silence(void) {
    for (int is_paused = 0; is_paused < 2; is_paused++) {
        CHECK(start(1, 0.5));
        const touch_counts *counts = &play.receiver->counts;
        touch_play_resume(&play);
        tick(200, 1);
        if (is_paused) touch_play_pause(&play);
        tick(50, 1);
        CHECK(!touch_is_zero(force_n));
        tick(3000, 0);
        CHECK(touch_is_zero(force_n) && is_slow);
        CHECK(counts->silences == 1 && counts->silent_ticks >= 1900 && counts->silent_ticks <= 2100);
        CHECK(latest_flags() & TOUCH_FLAG_SILENT);
        CHECK(strstr(touch_play_error(&play), "decodes"));
        tick(200, 1); /* it goes on */
        CHECK(!touch_is_zero(force_n) && is_slow);
        CHECK(!(latest_flags() & TOUCH_FLAG_SILENT) && !*touch_play_error(&play));
        CHECK(counts->silences == 1);
    }
    return 0;
}

/* What is no silence: both threads stood, as in a debugger; a pause of less than a second. */
static int check_pauses(void) {
    CHECK(start(1, 0.5));
    touch_play_resume(&play);
    tick(200, 1);
    for (int n = 0; n < 5; n++) {
        clock_ns += INT64_C(5000000000);
        tick(5, 0), tick(50, 1);
        tick(900, 0), tick(50, 1);
    }
    CHECK(play.receiver->counts.silent_ticks == 0);
    return 0;
}

/* A servo of a clock of its own that waits with touch_play_is_ready: also for a sign of life. */
static int check_waits(void) {
    CHECK(start(1, 0.5));
    touch_play_resume(&play);
    for (int n = 0; n < 5000; n++) {
        while (!touch_play_is_ready(&play, clock_ns)) (void)touch_play_decode(&play);
        tick(1, 0);
    }
    CHECK(play.receiver->counts.silent_ticks == 0 && play.receiver->counts.stalled_ticks == 0);
    return 0;
}

static int check_force_max(void) {
    CHECK(start(1, 0.0));
    double max_n = touch_fmin(play.file.force_max_n, 1e6);
    CHECK(play.options.device.force_max_n == max_n && play.receiver->settings.force_limits.peak == max_n);
    touch_device device = {1.0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (int n = 0; n < 2; n++) { /* options that are changed after opening */
        free(memory);
        CHECK(!touch_play_open(&play, file, file_size, &device));
        play.options.device.force_max_n = n ? -1.0 : 0.0;
        memory = malloc(touch_play_room(&play));
        CHECK(touch_play_start(&play, memory) == (n ? TOUCH_ARGUMENT : TOUCH_OK));
        if (!n) CHECK(play.receiver->settings.force_limits.peak == max_n);
    }
    const double wrong_n[] = {-1.0, 1e-7, 2e6, (double)INFINITY, (double)NAN};
    for (int n = 0; n < 5; n++) {
        CHECK(!start(1, wrong_n[n]) && play.code == TOUCH_ARGUMENT);
        CHECK(strstr(play.error, "greatest force") && strstr(play.error, "0 for"));
    }
    return 0;
}

int main(int count, char **words) {
    FILE *in = count == 6 ? fopen(words[2], "rb") : NULL;
    if (!in) return 64;
    file_size = fread(file, 1, sizeof file, in);
    fclose(in);
    hand_m = touch_vector_of(atof(words[3]), atof(words[4]), atof(words[5]));
    if (!strcmp(words[1], "stop")) return check_stop();
    if (!strcmp(words[1], "silence")) return check_silence() || check_pauses() || check_waits();
    if (!strcmp(words[1], "force-max")) return check_force_max();
    return 64;
}
