/* A receiver with its three threads: play_threads FILE.touch SECONDS SEED SPEED IS_LOOP LEAST. One thread ticks at the clock
   of the machine, one decodes, and this one gives orders at random times; at last it stops. Every force must be within its
   limits. It goes on for up to ten times SECONDS until LEAST ticks had a force: a loaded machine decodes late.
   Prints ticks, ticks with a force, ticks without a frame, frames that were left out, and seeks. */
#define _POSIX_C_SOURCE 200809L
#define TOUCH_IMPLEMENTATION
#include "touch_play.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static touch_play play;
static int64_t is_over, is_wrong, forces; /* read and written by all threads */

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void pause_us(int64_t us) {
    struct timespec wait = {us / 1000000, us % 1000000 * 1000};
    nanosleep(&wait, NULL);
}

static double random_state = 0.5;

static double any(void) { /* 0 to 1 */
    random_state = fmod(random_state * 16807.0, 2147483647.0);
    return random_state / 2147483647.0;
}

static void *decode(void *unused) {
    while (!touch_shared(&is_over))
        if (!touch_play_decode(&play)) pause_us(200);
    return unused;
}

/* Ticks of a hand that moves through the middle of the medium. */
static void *serve(void *unused) {
    touch_receiver *receiver = play.receiver;
    const touch_settings *settings = &receiver->settings;
    const touch_grid *grid = &play.file.grid;
    touch_vector before = touch_zero();
    int64_t start_ns = now_ns(), latest_ns = start_ns;
    while (!receiver->clock.is_released) {
        int64_t time_ns = now_ns();
        double at[3], t = 1e-9 * (double)(time_ns - start_ns), dt_s = 1e-9 * (double)(time_ns - latest_ns);
        for (int n = 0; n < 3; n++)
            at[n] = grid->origin_m[n] + (0.5 + 0.4 * sin((7.0 + 2 * n) * t)) * grid->spacing_m[n] * grid->shape[n];
        touch_vector force = touch_receiver_tick(receiver, touch_vector_of(at[0], at[1], at[2]), time_ns);
        double step = touch_norm(touch_subtract(force, before));
        if (!(touch_norm(force) <= settings->force_limits.peak)) touch_share(&is_wrong, 1);
        if (!(step <= settings->force_limits.slew_per_s * dt_s + 1e-12)) touch_share(&is_wrong, 2);
        if (touch_norm(force) > 0.0) touch_share(&forces, touch_shared(&forces) + 1);
        before = force, latest_ns = time_ns;
        pause_us((receiver->clock.deadline_ns - now_ns()) / 1000 > 0 ? 500 : 0);
    }
    if (touch_norm(before) != 0.0) touch_share(&is_wrong, 3);
    return unused;
}

static void order(void) {
    double kind = any();
    if (kind < 0.2) touch_play_pause(&play);
    else if (kind < 0.6) touch_play_resume(&play);
    else touch_play_seek(&play, any() * 1.2 * play.file.frame_count / play.file.rate_hz);
    (void)touch_play_is_over(&play);
}

/* Start with options; 0: refused. */
static int start(char **words) {
    static uint8_t file[1 << 22];
    touch_device device = {3.3, 0, 0, 0, 0, 0, 0, 0, 0};
    FILE *in = fopen(words[1], "rb");
    size_t size = in ? fread(file, 1, sizeof file, in) : 0;
    if (in) fclose(in);
    if (touch_play_open(&play, file, size, &device)) return 0;
    play.options.speed = strtod(words[4], NULL), play.options.is_loop = atoi(words[5]);
    play.options.log_rows = 64, play.options.max_ahead = 1024, random_state = strtod(words[3], NULL);
    return touch_play_start(&play, malloc(touch_play_room(&play))) == TOUCH_OK;
}

int main(int count, char **words) {
    pthread_t servo, decoder;
    if (count != 7 || !start(words)) return puts(play.error), 65;
    int64_t length_ns = (int64_t)(1e9 * strtod(words[2], NULL)), least = atoi(words[6]);
    int64_t start_ns = now_ns(), has_orders = strtod(words[3], NULL) > 0.0;
    if (pthread_create(&servo, NULL, serve, NULL) || pthread_create(&decoder, NULL, decode, NULL)) return 71;
    touch_play_resume(&play);
    while (now_ns() < start_ns + (touch_shared(&forces) < least ? 10 : 1) * length_ns) {
        pause_us(has_orders ? (int64_t)(60000 * any()) : 10000);
        if (has_orders) order();
    }
    touch_play_stop(&play);
    pthread_join(servo, NULL);
    touch_share(&is_over, 1);
    pthread_join(decoder, NULL);
    const touch_counts *counts = &play.receiver->counts;
    printf("%lld %lld %lld %lld %lld\n", (long long)counts->ticks, (long long)forces, (long long)counts->stalled_ticks,
           (long long)play.left_out, (long long)play.receiver->orders.generation - 1);
    if (play.code) return puts(play.error), 66;
    if (is_wrong) return printf("a force beyond its limit (%lld)\n", (long long)is_wrong), 1;
    return 0;
}
