/* A receiver that ticks at given positions, for tests: play FILE.touch POSITIONS OUT OPTIONS. POSITIONS: f64 [n][3], metres;
   OUT: f64 [n][5], media time, flags and force of each tick. OPTIONS: f64 of the device (peak, continuous, delay, inertia,
   damping, friction, resolution), whether it loops, start and speed. Prints the settings; decodes before each tick. */
#define TOUCH_IMPLEMENTATION
#include "touch_play.h"

#include <stdio.h>
#include <stdlib.h>

enum { OPTIONS = 10, AHEAD = 3 }; /* frames that are decoded ahead, as run_offline does at 30 Hz */

static void *contents(const char *name, size_t *size) {
    FILE *in = fopen(name, "rb");
    if (!in || fseek(in, 0, SEEK_END)) exit(64);
    *size = (size_t)ftell(in);
    void *bytes = malloc(*size ? *size : 1); /* exact: the sanitizer sees a read beyond its end */
    rewind(in);
    if (!bytes || fread(bytes, 1, *size, in) != *size) exit(64);
    fclose(in);
    return bytes;
}

static int refused(const touch_play *play) {
    puts(play->error);
    return 65;
}

static void choose(touch_play *play, const double *numbers) {
    play->options.device.force_max_n = numbers[0], play->options.device.force_continuous_n = numbers[1];
    play->options.device.delay_s = numbers[2], play->options.device.inertia_kg = numbers[3];
    play->options.device.damping_n_s_per_m = numbers[4], play->options.device.friction_n = numbers[5];
    play->options.device.resolution_m = numbers[6];
    play->options.is_loop = numbers[7] > 0.0, play->options.start_s = numbers[8], play->options.speed = numbers[9];
    play->options.is_simulated = 1, play->options.log_rows = 16;
}

int main(int count, char **words) {
    size_t size, bytes, options;
    if (count != 5) return 64;
    static void *file, *memory; /* static: reachable where a file is refused */
    static double *position, *numbers;
    file = contents(words[1], &size), position = (double *)contents(words[2], &bytes);
    numbers = (double *)contents(words[4], &options);
    FILE *out = fopen(words[3], "wb");
    static touch_play play;
    touch_device device = {1.0, 0, 0, 0, 0, 0, 0, 0, 0};
    if (!out || options != OPTIONS * sizeof *numbers) return 64;
    if (touch_play_open(&play, file, size, &device)) return refused(&play);
    choose(&play, numbers);
    memory = malloc(touch_play_room(&play));
    if (touch_play_start(&play, memory)) return refused(&play);
    const touch_settings *settings = &play.receiver->settings;
    printf("%.17g %.17g %.17g %.17g %.17g %.17g\n", settings->wall_n_per_m, settings->wall_level_n, settings->brake_n_s_per_m,
           settings->coupling_n_per_m, settings->friction, settings->damping_n_s_per_m);
    touch_play_resume(&play);
    for (size_t n = 0; n < bytes / 24; n++) {
        int64_t needed = play.receiver->clock.needs & (((int64_t)1 << TOUCH_FRAME_BITS) - 1);
        while (play.next < needed + AHEAD && touch_play_decode(&play)) {}
        if (play.code) return refused(&play);
        touch_vector at = touch_vector_of(position[3 * n], position[3 * n + 1], position[3 * n + 2]);
        touch_vector force = touch_receiver_tick(play.receiver, at, (int64_t)n * play.receiver->layout.tick_ns);
        const touch_receiver_layout *layout = &play.receiver->layout;
        const touch_log_row *row = (const touch_log_row *)(const void *)((char *)play.receiver + layout->log_offset);
        row += (int64_t)n % layout->log_rows;
        double values[5] = {row->media_s, (double)row->flags, force.x, force.y, force.z};
        if (fwrite(values, sizeof values, 1, out) != 1) return 64;
    }
    free(file), free(position), free(numbers), free(memory);
    return fclose(out) ? 64 : 0;
}
