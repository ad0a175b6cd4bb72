/* The library `touchfield`: touchfield.h around c/touch_play.h. */
#include "touchfield.h"

#define TOUCH_IMPLEMENTATION
#include "../../c/touch_play.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

struct touchfield {
    touch_play play;
    void *bytes, *memory; /* memory is NULL until a start succeeds */
    char axes[256];
};

typedef struct {
    const char *name;
    size_t offset; /* of a double in touch_play_options */
} number_option;

#define NUMBER(name, field) {name, offsetof(touch_play_options, field)}
static const number_option NUMBERS[] = {
    NUMBER("force_max_n", device.force_max_n),
    NUMBER("force_continuous_n", device.force_continuous_n),
    NUMBER("delay_s", device.delay_s),
    NUMBER("inertia_kg", device.inertia_kg),
    NUMBER("resolution_m", device.resolution_m),
    NUMBER("rate_hz", render.rate_hz),
    NUMBER("friction", render.friction),
    NUMBER("damping_n_s_per_m", render.damping_n_s_per_m),
    NUMBER("coupling_n_per_m", render.coupling_n_per_m),
    NUMBER("wall_n_per_m", render.wall_n_per_m),
    NUMBER("scale", render.scale),
    NUMBER("force_scale", render.force_scale),
    NUMBER("ramp_s", render.ramp_s),
    NUMBER("speed", speed),
    NUMBER("start_s", start_s),
};

touchfield *touchfield_open(const void *bytes, uint64_t size) {
    touch_device device = {0};
    touchfield *player = (touchfield *)calloc(1, sizeof *player);
    if (!player || !(player->bytes = malloc((size_t)size + 1))) {
        free(player);
        return NULL;
    }
    memcpy(player->bytes, bytes, (size_t)size);
    if (touch_play_open(&player->play, player->bytes, size, &device)) return player;
    const touch_file *file = &player->play.file;
    size_t count = file->axes.size < sizeof player->axes ? (size_t)file->axes.size : sizeof player->axes - 1;
    if (count) memcpy(player->axes, file->axes.bytes, count);
    return player;
}

void touchfield_close(touchfield *player) {
    if (!player) return;
    free(player->memory), free(player->bytes), free(player);
}

const char *touchfield_error(const touchfield *player) { return touch_play_error(&player->play); }

const char *touchfield_axes(const touchfield *player) { return player->axes; }

double touchfield_duration_s(const touchfield *player) {
    const touch_file *file = &player->play.file;
    return file->rate_hz > 0.0 ? file->frame_count / file->rate_hz : 0.0;
}

double touchfield_force_max_n(const touchfield *player) { return player->play.file.force_max_n; }

int touchfield_set(touchfield *player, const char *option, double value) {
    touch_play_options *options = &player->play.options;
    if (player->memory || !(fabs(value) <= 1e300)) return 0;
    if (!strcmp(option, "is_loop")) return options->is_loop = value != 0.0, 1;
    if (!strcmp(option, "is_complete")) return options->is_complete = value != 0.0, 1;
    if (!strcmp(option, "is_passive")) return options->render.is_passive = value != 0.0, 1;
    for (size_t n = 0; n < sizeof NUMBERS / sizeof *NUMBERS; n++) {
        if (strcmp(option, NUMBERS[n].name)) continue;
        memcpy((char *)options + NUMBERS[n].offset, &value, sizeof value);
        return 1;
    }
    return 0;
}

int touchfield_start(touchfield *player) {
    touch_play *play = &player->play;
    if (play->code) return play->code;
    if (player->memory) return TOUCH_ARGUMENT; /* it plays on */
    player->memory = malloc((size_t)touch_play_room(play));
    if (touch_play_start(play, player->memory)) free(player->memory), player->memory = NULL;
    return play->code;
}

int touchfield_decode(touchfield *player) { return player->memory && touch_play_decode(&player->play); }

int touchfield_tick(touchfield *player, double x, double y, double z, int64_t now_ns, double force_n[3]) {
    touch_vector force = touch_zero();
    if (player->memory) force = touch_receiver_tick(player->play.receiver, touch_vector_of(x, y, z), now_ns);
    force_n[0] = force.x, force_n[1] = force.y, force_n[2] = force.z;
    return !touch_is_zero(force);
}

int touchfield_is_ready(const touchfield *player, int64_t now_ns) {
    return !player->memory || touch_play_is_ready(&player->play, now_ns);
}

void touchfield_resume(touchfield *player) {
    if (player->memory) touch_play_resume(&player->play);
}

void touchfield_pause(touchfield *player) {
    if (player->memory) touch_play_pause(&player->play);
}

void touchfield_seek(touchfield *player, double time_s) {
    if (player->memory) touch_play_seek(&player->play, time_s);
}

void touchfield_stop(touchfield *player) {
    if (player->memory) touch_play_stop(&player->play);
}

int touchfield_is_released(const touchfield *player) {
    return !player->memory || touch_shared(&player->play.receiver->clock.is_released) != 0;
}

int touchfield_is_over(const touchfield *player) { return !player->memory || touch_play_is_over(&player->play); }

double touchfield_media_s(const touchfield *player) {
    return player->memory ? player->play.receiver->clock.media_s : 0.0;
}
