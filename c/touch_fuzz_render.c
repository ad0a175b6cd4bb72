/* A fuzzer of the renderer: random media, settings and trajectories, some of them absurd. Each force and torque must be
   finite, within its peak and its slew limit; after a stop it must reach zero, and stay there.

       touch_fuzz_render SEED ROUNDS

   Media are voxels or bodies, blended between two frames, with a deformation that may yield, a vibration and materials;
   the hand is a point, a point with a proxy or a coupling, or a tool. bench/fuzz_c.py runs it under the sanitizers. */
#include "touch_render.h"

#include <stdio.h>
#include <stdlib.h>

enum { MEMORY_BYTES = 1 << 20, MAX_BRICKS = 8, MAX_BODIES = 3, TICKS = 60, MAX_POINTS = 20 };

/* -- random numbers --------------------------------------------------------------------------------------------------- */

static uint64_t state;

static uint32_t any(uint32_t below) { /* xorshift64* (Vigna 2016) */
    state ^= state >> 12, state ^= state << 25, state ^= state >> 27;
    return (uint32_t)((state * 0x2545f4914f6cdd1du) >> 33) % below;
}

static double uniform(double low, double high) { return low + (high - low) * (any(1u << 30) / (double)(1u << 30)); }

/* A number whose size is anywhere between two powers of ten. */
static double any_size(double low, double high) { return pow(10.0, uniform(low, high)); }

static double absurd(void) {
    static const double numbers[] = {NAN, INFINITY, -INFINITY, 0.0, -0.0, 1e308, -1e308, 5e-324, 1e6, -1e-300};
    return numbers[any(sizeof numbers / sizeof *numbers)];
}

static touch_vector any_vector(double size) {
    return touch_vector_of(uniform(-size, size), uniform(-size, size), uniform(-size, size));
}

static void any_quaternion(double q[4]) {
    double square = 0.0;
    for (int n = 0; n < 4; n++) q[n] = uniform(-1, 1), square += q[n] * q[n];
    for (int n = 0; n < 4; n++) q[n] = square > 1e-3 ? q[n] / sqrt(square) : n == 0;
}

/* -- a medium --------------------------------------------------------------------------------------------------------- */

static uint64_t memory[MEMORY_BYTES / 8];
static int64_t top; /* of the memory that is in use */

static int64_t take(uint64_t bytes) {
    int64_t offset = top;
    top += (int64_t)((bytes + 63) / 64 * 64);
    if (top > MEMORY_BYTES) abort();
    return offset;
}

static void *at(int64_t offset) { return (char *)memory + offset; }

/* A force at a sample: a wall, noise, or nothing; sometimes enormous. */
static void any_force(int kind, double size_n, int sample, float out[3]) {
    double depth = 7 - (sample & 7);
    for (int n = 0; n < 3; n++) out[n] = kind == 1 ? (float)uniform(-size_n, size_n) : 0.0f;
    if (kind == 0) out[2] = (float)(size_n * depth / 7.0);
    if (kind == 2 && any(4) == 0) out[any(3)] = (float)(any(2) ? size_n : -size_n);
}

/* The cells of a random field; spacing about 5 mm, around the origin. */
static int64_t any_field(void) {
    static float forces_n[MAX_BRICKS][512][3];
    int32_t brick[MAX_BRICKS][3], cell[8 * MAX_BRICKS][3];
    int kind = (int)any(3);
    double size_n = any(8) ? any_size(-3, 1.5) : any_size(-30, 30), spacing_m[3], origin_m[3];
    touch_field_bricks field = {brick[0], forces_n[0][0], 0};
    touch_cell_box box;
    for (int32_t b = 0; b < 8; b++) {
        if (any(3) == 0) continue;
        brick[field.bricks][0] = b >> 2, brick[field.bricks][1] = b >> 1 & 1, brick[field.bricks][2] = b & 1;
        for (int s = 0; s < 512; s++) any_force(kind, size_n, s, forces_n[field.bricks][s]);
        field.bricks++;
        if (field.bricks == 2) break;
    }
    for (int n = 0; n < 3; n++) spacing_m[n] = uniform(0.002, 0.006), origin_m[n] = -8 * spacing_m[n];
    uint64_t bricks = touch_find_cells(&field, NULL, &box, NULL);
    touch_find_cells(&field, NULL, &box, cell[0]);
    int64_t offset = take(touch_cells_room(bricks));
    touch_cells *cells = (touch_cells *)at(offset);
    touch_start_cells(cells, &box, cell[0], bricks, spacing_m, origin_m);
    touch_fill_cells(cells, &box, cell[0], 0, bricks, &field);
    return offset;
}

static void any_pose(touch_body_pose *pose, int64_t cells_offset, int is_voxels) {
    memset(pose, 0, sizeof *pose);
    pose->cells_offset = cells_offset, pose->is_identity = is_voxels, pose->quaternion[0] = 1.0;
    if (!is_voxels) {
        any_quaternion(pose->quaternion), pose->position_m = any_vector(0.03);
        if (any(2)) pose->surface_damping_n = any_vector(0.5), pose->surface_damping_n_per_m = any_vector(5.0);
    }
    const double *q = pose->quaternion;
    pose->rotation = touch_rotation_of(q[0], touch_vector_of(q[1], q[2], q[3]));
}

/* A deformation behind a frame: displacements small beside the cells of its lattice. */
static void any_deformation(touch_frame_header *header, int64_t frame_offset, int64_t yield_offset) {
    enum { POINTS = 5 };
    uint64_t bytes = POINTS * POINTS * POINTS * sizeof(touch_vector);
    int64_t offset = take(sizeof(touch_deformation) + bytes);
    touch_deformation *d = (touch_deformation *)at(offset);
    touch_vector *u = (touch_vector *)(void *)(d + 1);
    for (int n = 0; n < 3; n++) d->point_count[n] = POINTS;
    d->corner_m = touch_vector_of(-0.05, -0.05, -0.05), d->cells_per_m = touch_vector_of(20.0, 20.0, 20.0);
    d->yield_offset = yield_offset, d->compliance_m_per_n = any_size(-5, -2), d->relaxation_s = any_size(-3, 1);
    d->max_yield_m = 0.01;
    for (int n = 0; n < POINTS * POINTS * POINTS; n++) u[n] = any_vector(0.005);
    header->deformation_offset = offset - frame_offset;
}

typedef struct {
    int64_t offset[2]; /* of the frames */
} random_medium;

static random_medium any_medium(void) {
    random_medium medium;
    int is_voxels = (int)any(2), bodies = is_voxels ? 1 : 1 + (int)any(MAX_BODIES), is_bent = is_voxels && any(3) == 0;
    int64_t cells[MAX_BODIES + 2], vibration = any(3) ? 0 : any_field();
    int64_t yields = is_bent && any(2) ? take(125 * sizeof(touch_vector)) : 0;
    for (int n = 0; n < bodies + 1; n++) cells[n] = any_field();
    for (int f = 0; f < 2; f++) {
        int64_t offset = take(sizeof(touch_frame_header) + (uint64_t)bodies * sizeof(touch_body_pose));
        touch_frame_header *header = (touch_frame_header *)at(offset);
        header->body_count = bodies, header->vibration_offset = vibration;
        header->force_max_n = is_voxels ? (double)INFINITY : any_size(-1, 1.5);
        header->force_floor2_n2 = is_voxels ? 0.0 : 1e-18 * header->force_max_n * header->force_max_n;
        for (int n = 0; n < bodies; n++) /* the last body may deform */
            any_pose((touch_body_pose *)(void *)(header + 1) + n, cells[n == bodies - 1 ? n + f : n], is_voxels);
        if (is_bent) any_deformation(header, offset, yields);
        medium.offset[f] = offset;
    }
    return medium;
}

/* -- settings --------------------------------------------------------------------------------------------------------- */

static void any_limits(touch_limits *limits, touch_limited *limited) {
    limits->peak = any_size(-3, 2);
    limits->continuous = any(2) ? limits->peak * uniform(0.01, 0.99) : 0.0;
    limits->slew_per_s = limits->peak * any_size(0.5, 4);
    limited->limit = limits->peak;
}

static void any_material(touch_settings *settings) {
    enum { SPEEDS = 2, FORCES = 2 };
    uint64_t numbers = SPEEDS + FORCES + SPEEDS * FORCES * TOUCH_BANDS;
    int64_t offset = take(sizeof(touch_material_sines) + sizeof(touch_material) + 8 * numbers);
    touch_material_sines *sines = (touch_material_sines *)at(offset);
    touch_material *material = (touch_material *)(void *)(sines + 1);
    int64_t table = offset + (int64_t)sizeof *sines + (int64_t)sizeof *material;
    double *number = (double *)at(table);
    for (int n = 0; n < TOUCH_SINE_COUNT; n++)
        sines->frequency_rad_s[n] = 50.0 * pow(1.06, n), sines->phase_rad[n] = uniform(0.0, 6.0);
    material->friction = any(4) ? uniform(0.0, 1.0) : (double)NAN, material->static_friction = uniform(0.0, 2.0);
    material->slip_m = any_size(-5, -1), material->body = any(2) ? -1 : (int64_t)any(2);
    material->low_m = touch_vector_of(-1.0, -1.0, -1.0), material->high_m = touch_vector_of(1.0, uniform(-0.01, 0.01), 1.0);
    material->speed_count = SPEEDS, material->speed_offset = table;
    material->force_count = FORCES, material->force_offset = table + 8 * SPEEDS;
    material->level_offset = table + 8 * (SPEEDS + FORCES);
    for (uint64_t n = 0; n < numbers; n++) number[n] = uniform(0.0, 0.5);
    number[0] = 0.01, number[1] = 0.3, number[2] = 0.2, number[3] = 2.0; /* they ascend */
    settings->material_offset = offset, settings->material_count = 1;
}

static void any_tool(touch_settings *settings) {
    int points = 1 + (int)any(MAX_POINTS);
    settings->tool_point_count = points, settings->tool_offset = take((uint64_t)points * 6 * sizeof(float));
    settings->tool_weight = 4.0 / points, settings->tool_reach_m = 0.02;
    float *numbers = (float *)at(settings->tool_offset); /* positions, then normals, by component */
    for (int n = 0; n < points; n++) {
        touch_vector normal = any_vector(1.0);
        double size = touch_norm(normal) > 0.0 ? touch_norm(normal) : 1.0;
        const double unit[3] = {normal.x / size, normal.y / size, normal.z / size};
        for (int a = 0; a < 3; a++) {
            numbers[a * points + n] = (float)(0.01 * unit[a]);
            numbers[(3 + a) * points + n] = (float)unit[a];
        }
    }
}

static void any_hand(touch_settings *settings) {
    uint32_t kind = any(4);
    if (kind == 0) any_tool(settings);
    if (kind == 1) settings->coupling_n_per_m = any_size(0, 5);
    if (kind > 1) {
        settings->wall_n_per_m = kind == 2 ? any_size(0, 5) : 0.0, settings->wall_level_n = any_size(-4, 0);
        settings->wall_spacing_m = touch_vector_of(0.004, 0.004, 0.004);
    }
}

static void any_settings(touch_receiver *receiver) {
    touch_settings *settings = &receiver->settings;
    double q[4];
    any_quaternion(q);
    settings->rate_hz = any(4) ? 1000.0 : any_size(1, 4);
    settings->friction = any(2) ? uniform(0.0, 2.0) : 0.0, settings->damping_n_s_per_m = any(2) ? any_size(-3, 1) : 0.0;
    settings->stick_n_per_m = any(4) ? any_size(0, 5) : 0.0, settings->stick_n_s_per_m = any(2) ? any_size(-2, 2) : 0.0;
    settings->brake_n_s_per_m = any(2) ? any_size(-2, 2) : 0.0;
    settings->is_passive = any(2);
    settings->scale = any_size(-1, 1), settings->force_scale = any_size(-1, 1), settings->clutch_m = any_vector(0.02);
    if (any(2)) settings->gravity_n = any_vector(0.5);
    settings->axes = touch_rotation_of(q[0], touch_vector_of(q[1], q[2], q[3])), settings->handedness = 1.0;
    settings->thermal_s = any_size(-2, 1), settings->ramp_s = any_size(-3, 0);
    settings->velocity_cutoff_rad_s = any_size(1, 4), settings->delay_ticks = uniform(0.0, TOUCH_MAX_DELAY);
    any_limits(&settings->force_limits, &receiver->state.force);
    if (any(2)) any_limits(&settings->torque_limits, &receiver->state.torque);
    if (any(3) == 0) any_material(settings);
    any_hand(settings);
    receiver->grip.orientation[0] = 1.0;
}

/* -- a trajectory ----------------------------------------------------------------------------------------------------- */

static double any_dt(double period_s) {
    switch (any(12)) {
    case 0: return 0.0;
    case 1: return -period_s;
    case 2: return any_size(-12, 12);
    case 3: return absurd();
    default: return period_s * uniform(0.5, 1.5);
    }
}

static touch_vector next_position(touch_vector position_m) {
    switch (any(16)) {
    case 0: return any_vector(0.05);
    case 1: return touch_vector_of(absurd(), absurd(), absurd());
    case 2: return touch_vector_of(position_m.x, absurd(), position_m.z);
    case 3: return any_vector(any_size(-2, 8));
    default: return touch_add(touch_is_position(position_m) ? position_m : any_vector(0.02), any_vector(0.001));
    }
}

/* Whether an output obeys its limits after a step of dt; `before` is the one before. */
static int is_within(const touch_settings *settings, const touch_limits *limits, touch_vector before, touch_vector now,
                     double dt_s) {
    touch_vector step = touch_subtract(now, before);
    if (!touch_is_finite(now) || touch_norm(now) > limits->peak) return 0;
    if (!touch_is_time_step(settings, dt_s)) return touch_norm(step) == 0.0;
    return touch_norm(step) <= limits->slew_per_s * touch_clamped_dt(settings, dt_s);
}

static uint64_t forces, torques; /* ticks that had one */

typedef struct {
    touch_receiver *receiver;
    touch_vector force_n, torque_nm; /* of the tick before */
} watched;

static int is_tick_allowed(watched *w, touch_vector force_n, double dt_s) {
    const touch_settings *settings = &w->receiver->settings;
    touch_vector torque_nm = w->receiver->state.torque.output;
    int is_allowed = is_within(settings, &settings->force_limits, w->force_n, force_n, dt_s) &&
                     is_within(settings, &settings->torque_limits, w->torque_nm, torque_nm, dt_s);
    if (!is_allowed)
        fprintf(stderr, "force %g %g %g after %g %g %g, torque %g %g %g, dt %g\n", force_n.x, force_n.y, force_n.z,
                w->force_n.x, w->force_n.y, w->force_n.z, torque_nm.x, torque_nm.y, torque_nm.z, dt_s);
    w->force_n = force_n, w->torque_nm = torque_nm;
    forces += touch_norm(force_n) > 0.0, torques += touch_norm(torque_nm) > 0.0;
    return is_allowed;
}

/* The force goes to zero after a stop, within the time of the ramp or of the slew limit. */
static int is_released(watched *w) {
    const touch_settings *settings = &w->receiver->settings;
    double dt_s = 1.0 / settings->rate_hz, slowest = settings->force_limits.slew_per_s / settings->force_limits.peak;
    if (settings->torque_limits.peak > 0.0)
        slowest = touch_fmin(slowest, settings->torque_limits.slew_per_s / settings->torque_limits.peak);
    double ticks = 16.0 + 2.0 * settings->rate_hz * (settings->ramp_s + 1.0 / slowest);
    for (double n = 0; n < ticks; n++) {
        touch_vector force_n = touch_release(w->receiver, dt_s);
        if (!is_tick_allowed(w, force_n, dt_s)) return 0;
    }
    return touch_norm(w->force_n) == 0.0 && touch_norm(w->torque_nm) == 0.0;
}

static int play_round(void) {
    touch_receiver *receiver = (touch_receiver *)(void *)memory;
    watched w = {receiver, touch_zero(), touch_zero()};
    memset(memory, 0, sizeof memory), top = 0;
    (void)take(sizeof *receiver);
    any_settings(receiver);
    random_medium medium = any_medium();
    touch_vector position_m = any_vector(0.02);
    double blend = uniform(-0.5, 1.5);
    for (int n = 0; n < TICKS; n++) {
        double dt_s = any_dt(1.0 / receiver->settings.rate_hz);
        int64_t before = any(12) ? medium.offset[0] : 0, after = any(12) ? medium.offset[any(8) > 0] : 0;
        if (any(8) == 0) blend = any(8) ? uniform(-0.5, 1.5) : absurd();
        if (any(6) == 0) any_quaternion(receiver->grip.orientation);
        if (any(20) == 0) receiver->grip.orientation[any(4)] = absurd();
        position_m = next_position(position_m);
        touch_vector force_n = touch_tick(receiver, before, after, blend, position_m, dt_s);
        if (!is_tick_allowed(&w, force_n, dt_s)) return 0;
    }
    if (is_released(&w)) return 1;
    fprintf(stderr, "after a stop, or on the way to zero: %g %g %g\n", w.force_n.x, w.force_n.y, w.force_n.z);
    return 0;
}

int main(int count, char **words) {
    if (count != 3) return fprintf(stderr, "touch_fuzz_render SEED ROUNDS\n"), 64;
    uint64_t seed = strtoull(words[1], 0, 10), rounds = strtoull(words[2], 0, 10);
    for (uint64_t round = 0; round < rounds; round++) {
        state = seed * 0x9e3779b97f4a7c15u + round + 1, any(2); /* a round is found again by its seed and number */
        if (!play_round()) return fprintf(stderr, "seed %s, round %llu\n", words[1], (unsigned long long)round), 1;
    }
    printf("%llu rounds of %d ticks; %llu forces, %llu torques\n", (unsigned long long)rounds, TICKS,
           (unsigned long long)forces, (unsigned long long)torques);
    return 0;
}
