/* touch_play.h: a receiver of .touch files for an engine, in one piece; C99 and C++11. It opens a file, lays out the memory
   of a receiver in memory of the caller, chooses the settings for a device, decodes ahead in a thread of the caller, blends
   segments, and plays, pauses, seeks and stops. The servo's thread calls touch_receiver_tick alone (touch_render.h).

       touch_play play;                                      // lives as long as the receiver
       touch_device device = {0};                            // what it does not state is 0
       device.force_max_n = 3.3;                             // 0: the greatest force of the medium
       touch_play_open(&play, bytes, size, &device);         // TOUCH_OK, or why not: play.error
       play.options.is_loop = 1;                             // where the defaults do not suit
       touch_play_start(&play, malloc(touch_play_room(&play)));
       play.receiver->settings.friction = 0.3;               // settings may be changed until the first tick
       touch_play_resume(&play);
       // in a thread that decodes:    while (is_open) if (!touch_play_decode(&play)) sleep a millisecond;
       // in the thread of the servo:  force = touch_receiver_tick(play.receiver, position, m, clock, ns);
       // in one thread that orders:   touch_play_pause(&play);  touch_play_seek(&play, 1.5);  touch_play_stop(&play);

   Each of the three threads writes its own fields only, and none waits for another. touch_play_stop brings the force to
   zero for ever; play.receiver->clock.is_released says when it is there. If the thread that decodes does not call for a second
   (it hangs, or has ended), the force goes to zero, too, until it calls again: touch_play_error reports it, and counts.silences
   of the receiver.

   It plays what touch.h decodes: voxels of coder `touch`, objects and vibration. The memory is that of the decoder
   (touch_room: an upper limit by the bytes of the file, of which a file touches what it needs), thirteen times that of one
   decoded frame (of bodies: of all that the decoder has), the log, and `frames_bytes` for the frames that are decoded
   ahead: at most `max_ahead` of them. A file of which two frames do not fit there is refused (TOUCH_MEMORY). On a machine
   that decodes more slowly than the medium plays, frames that cannot be ready at their time are left out, and the frame
   before is shown in their place: `left_out` counts them. For that, segments must be shorter than `max_ahead`.
   The stiffness of walls is the one that the file's provenance states, else that of the field; materials are those that are
   stored with the medium. Deformations and tools are no part of a file: write them as touch_receiver.h says. */
#ifndef TOUCH_PLAY_H
#define TOUCH_PLAY_H

#include "touch.h"
#include "touch_materials.h"
#include "touch_render.h"
#include "touch_segment_blend.h"
#include "touch_settings.h"

typedef struct {
    touch_render_options render;
    touch_device device;
    int is_loop, blends;     /* whether segments blend into each other, and the force fades over seams */
    double speed, start_s;
    int64_t max_ahead;       /* frames that are decoded ahead, a power of two */
    int64_t log_rows;        /* of the latest ticks; 0: no log */
    uint64_t frames_bytes;   /* for frames that are decoded ahead */
    int is_simulated;        /* time is the number of the tick divided by the rate */
    int is_complete;         /* no frame is left out: for a servo that waits with touch_play_is_ready */
} touch_play_options;

typedef struct { /* a field of a frame, in the order of its bricks */
    touch_field_bricks bricks;
    touch_grid grid;
    touch_cell_box box;      /* of its cells */
    uint64_t cell_count;     /* bricks of cells */
    int64_t cells_offset;    /* of a rigid body's cells, which all frames share; else 0 */
} touch_play_field;

typedef struct { /* the fields of a frame; the last one is the vibration */
    touch_arena arena;
    touch_play_field *field;
} touch_play_fields;

enum { TOUCH_PLAY_DURATIONS = 16 }; /* latest frames in the mean decoding time */

typedef struct { /* how long decoding takes: time of the servo's ticks, and frames that were decoded in it */
    double seconds[TOUCH_PLAY_DURATIONS];
    int64_t frames[TOUCH_PLAY_DURATIONS], count; /* of durations so far */
    int64_t latest;                              /* unrolled frame, -1: none */
    double frame_s;                              /* mean; 0: not known yet */
} touch_play_pace;

typedef struct { /* a frame in the ring */
    int64_t frame, offset;
} touch_play_slot;

typedef struct {
    touch_play_options options;
    touch_file file;
    touch_receiver *receiver;
    int code;                /* why it plays no longer: TOUCH_..., and in words */
    const char *error;
    touch_stated_text materials; /* the table that is stored with the medium, JSON; NULL: none */
    int64_t left_out;        /* frames that could not be decoded in time; read it with touch_shared */

    /* of the thread that decodes */
    touch_decoder decoder;
    touch_arena frame_arena;
    touch_frame frame;       /* the decoder's latest */
    int64_t decoded;         /* its number, -1: none */
    touch_play_fields fields[3], *former, *latest, *spare; /* of the segment before, of the latest frame; for the next */
    int64_t former_frame, latest_frame; /* -1: none */
    int64_t generation, next; /* the unrolled frame to be written */
    int is_ready;            /* `latest` is that frame, and waits for room */
    touch_play_slot *slot;   /* the frames in the ring, from first_slot on */
    int64_t first_slot, slots;
    int64_t ring_start, ring_stop, head;
    int is_published;        /* a frame of this generation */
    touch_play_pace pace;
    double stiffest_n_per_m;
    touch_field_wall wall;
} touch_play;

/* -- opening ---------------------------------------------------------------------------------------------------------- */

#define TOUCH_PLAY_ALIGNMENT 64
#define TOUCH_PLAY_MAX_FORCE_N 1e6
#define TOUCH_PLAY_FLOOR_FRACTION 1e-9    /* of F_max: a body's force below it is a rounding error at its edge */

static inline int touch_play_fail(touch_play *play, int code, const char *error) {
    play->error = error, play->code = code;
    return code;
}

static inline uint64_t touch_play_aligned(uint64_t bytes) {
    return (bytes + TOUCH_PLAY_ALIGNMENT - 1) / TOUCH_PLAY_ALIGNMENT * TOUCH_PLAY_ALIGNMENT;
}

/* The greatest force of the device: 0 becomes that of the medium. */
static inline int touch_play_choose_force_max(touch_play *play) {
    double *max_n = &play->options.device.force_max_n;
    if (*max_n == 0.0) *max_n = touch_fmin(play->file.force_max_n, TOUCH_PLAY_MAX_FORCE_N);
    else if (!(*max_n >= 1e-6 && *max_n <= TOUCH_PLAY_MAX_FORCE_N))
        return touch_play_fail(play, TOUCH_ARGUMENT,
                               "the greatest force of the device must be 1e-6 to 1e6 N, or 0 for that of the medium");
    return TOUCH_OK;
}

/* Open a file that lies in memory, and choose options for a device; TOUCH_OK, or play->code and play->error. */
static inline int touch_play_open(touch_play *play, const void *bytes, uint64_t size, const touch_device *device) {
    memset(play, 0, sizeof *play);
    play->error = "";
    int code = touch_open(&play->file, bytes, size);
    if (code) return touch_play_fail(play, code, play->file.error);
    if (TOUCH_HAS_EXTRAS)
        play->materials = touch_provenance_of(play->file.provenance.bytes, play->file.provenance.size, "materials.json");
    touch_play_options *options = &play->options;
    options->render = touch_render_defaults(), options->device = *device;
    options->blends = 1, options->speed = 1.0;
    options->max_ahead = 64, options->frames_bytes = (uint64_t)1 << 28;
    return touch_play_choose_force_max(play);
}

static inline uint64_t touch_play_parts(const touch_play *play) {
    return play->file.object_count ? play->file.object_count : 1;
}

static inline uint64_t touch_play_materials_room(const touch_play *play) {
    return play->materials.at ? touch_play_aligned(touch_materials_room(play->materials.size)) : 0;
}

/* Bytes of the receiver: struct, directory, log, materials and frames. */
static inline uint64_t touch_play_receiver_room(const touch_play *play) {
    uint64_t room = touch_play_aligned(sizeof(touch_receiver));
    room += touch_play_aligned((uint64_t)play->options.max_ahead * sizeof(touch_directory_entry));
    room += touch_play_aligned((uint64_t)play->options.log_rows * sizeof(touch_log_row));
    return room + touch_play_materials_room(play) + touch_play_aligned(play->options.frames_bytes);
}

/* Bytes of the fields of a frame: forces and numbers of its bricks, those of a blend with as many others, and work for their
   cells. The fields of bodies live in the arena of the decoder. */
static inline uint64_t touch_play_fields_room(const touch_play *play, uint64_t decoder_room, uint64_t frame_room) {
    if (play->file.object_count) frame_room += decoder_room;
    return touch_play_aligned(4096 + 4 * frame_room + (touch_play_parts(play) + 1) * sizeof(touch_play_field));
}

/* Bytes of memory that touch_play_start takes. */
static inline uint64_t touch_play_room(const touch_play *play) {
    uint64_t decoder_room, frame_room;
    touch_room(&play->file, &decoder_room, &frame_room);
    return touch_play_receiver_room(play) + touch_play_aligned(decoder_room) + touch_play_aligned(frame_room) +
           3 * touch_play_fields_room(play, decoder_room, frame_room) +
           touch_play_aligned((uint64_t)play->options.max_ahead * sizeof(touch_play_slot)) + TOUCH_PLAY_ALIGNMENT;
}

/* Memory of an arena in aligned pieces; NULL: it has no room. */
static inline void *touch_play_take(touch_arena *arena, uint64_t bytes) {
    bytes = touch_play_aligned(bytes);
    if (bytes > arena->size - arena->used) return NULL;
    void *at = arena->base + arena->used;
    arena->used += bytes;
    return at;
}

/* -- decoding --------------------------------------------------------------------------------------------------------- */

/* A sign of life of the thread that decodes, for the servo. */
static inline void touch_play_beat(touch_play *play) {
    int64_t *heartbeat = &play->receiver->orders.feed_heartbeat;
    touch_share(heartbeat, *heartbeat + 1);
}

/* Decode a frame: the next one, or from the start of its segment. */
static inline int touch_play_decode_frame(touch_play *play, int64_t frame) {
    uint32_t segment = touch_segment_of(&play->file, (uint32_t)frame);
    int code = TOUCH_OK, is_behind = play->decoded >= 0 && play->decoded < frame;
    if (play->decoded == frame) return TOUCH_OK;
    if (!is_behind || touch_segment_of(&play->file, (uint32_t)play->decoded) != segment)
        code = touch_seek(&play->decoder, segment);
    play->decoded = -1;
    while (!code && play->decoded < frame) {
        touch_play_beat(play);
        play->frame_arena.used = 0;
        code = touch_next(&play->decoder, &play->frame_arena, &play->frame);
        play->decoded = code ? -1 : (int64_t)play->frame.number;
    }
    return code ? touch_play_fail(play, code, play->decoder.error) : TOUCH_OK;
}

/* Heap sort of numbers of bricks, with where their forces are. */
static inline void touch_play_sort(uint64_t *pair, int64_t count) {
    for (int64_t start = count / 2, stop = count; stop > 1;) {
        uint64_t moved;
        if (start > 0) moved = pair[--start];
        else moved = pair[--stop], pair[stop] = pair[0];
        int64_t parent = start, child = 2 * start + 1;
        for (; child < stop; child = 2 * parent + 1) {
            if (child + 1 < stop && pair[child + 1] > pair[child]) child++;
            if (!(pair[child] > moved)) break;
            pair[parent] = pair[child], parent = child;
        }
        pair[parent] = moved;
    }
}

/* The bricks of a decoded field in ascending order; 0: the arena has no room. */
static inline int touch_play_gather(const touch_field *field, touch_arena *arena, touch_play_field *out) {
    uint64_t bricks = field->bricks, count = 0;
    int32_t *brick = (int32_t *)touch_play_take(arena, 12 * bricks);
    float *forces_n = (float *)touch_play_take(arena, 4 * TOUCH_BRICK_FLOATS * bricks);
    uint64_t mark = arena->used, *pair = (uint64_t *)touch_play_take(arena, 8 * bricks);
    if (!brick || !forces_n || !pair) return 0;
    for (uint64_t n = 0; n <= field->mask && count < bricks; n++)
        if (field->table[2 * n]) pair[count++] = (uint64_t)(field->table[2 * n] - 1) << 32 | field->table[2 * n + 1];
    touch_play_sort(pair, (int64_t)count);
    uint64_t ny = (field->grid.shape[1] + 7) / 8, nz = (field->grid.shape[2] + 7) / 8;
    for (uint64_t n = 0; n < count; n++) {
        uint64_t number = pair[n] >> 32, slot = pair[n] & 0xffffffffu;
        brick[3 * n] = (int32_t)(number / nz / ny), brick[3 * n + 1] = (int32_t)(number / nz % ny);
        brick[3 * n + 2] = (int32_t)(number % nz);
        memcpy(forces_n + TOUCH_BRICK_FLOATS * n, field->forces_n + TOUCH_BRICK_FLOATS * slot, 4 * TOUCH_BRICK_FLOATS);
    }
    arena->used = mark;
    out->grid = field->grid;
    out->bricks.brick = brick, out->bricks.forces_n = forces_n, out->bricks.bricks = count;
    return 1;
}

/* -- blends of segments ----------------------------------------------------------------------------------------------- */

/* Frames of a segment; as many as a blend can take, if there are more. */
static inline int64_t touch_play_segment_length(const touch_play *play, int64_t first, uint32_t segment) {
    int64_t length = 1, enough = (int64_t)(2.0 * TOUCH_BLEND_S * play->file.rate_hz) + 2, count = play->file.frame_count;
    while (length < enough && first + length < count &&
           touch_segment_of(&play->file, (uint32_t)(first + length)) == segment)
        length++;
    return length;
}

/* The first frame of the segment that has a frame. */
static inline int64_t touch_play_first_of(const touch_play *play, int64_t frame) {
    int64_t low = 0, high = frame;
    uint32_t segment = touch_segment_of(&play->file, (uint32_t)frame);
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (touch_segment_of(&play->file, (uint32_t)middle) == segment) high = middle;
        else low = middle + 1;
    }
    return low;
}

/* Where bricks of two fields are, -1: not there; slot [2][returned]. Both ascend. */
static inline int64_t touch_play_merge(const touch_field_bricks *a, const touch_field_bricks *b, int32_t *brick,
                                       int64_t *slot, int64_t capacity) {
    uint64_t i = 0, j = 0;
    int64_t count = 0;
    while (i < a->bricks || j < b->bricks) {
        const int32_t *p = a->brick + 3 * i, *q = b->brick + 3 * j;
        int64_t first = i < a->bricks ? touch_brick_order(p[0], p[1], p[2]) : INT64_MAX;
        int64_t second = j < b->bricks ? touch_brick_order(q[0], q[1], q[2]) : INT64_MAX;
        memcpy(brick + 3 * count, first <= second ? p : q, 12);
        slot[count] = first <= second ? (int64_t)i : -1, slot[capacity + count] = second <= first ? (int64_t)j : -1;
        i += first <= second, j += second <= first, count++;
    }
    return count;
}

/* Blend the field of the former segment's last frame into a field; where there is no room for that, it stays as it is. */
static inline void touch_play_blend(const touch_blend_rule *rule, const touch_play_field *former, touch_play_field *field,
                                    touch_arena *arena) {
    uint64_t mark = arena->used, capacity = former->bricks.bricks + field->bricks.bricks, selected = 0;
    int32_t *brick = (int32_t *)touch_play_take(arena, 12 * capacity);
    float *forces_n = (float *)touch_play_take(arena, 4 * TOUCH_BRICK_FLOATS * capacity);
    int64_t *slot = (int64_t *)touch_play_take(arena, 16 * capacity);
    uint8_t *has_force = (uint8_t *)touch_play_take(arena, capacity);
    if (!brick || !forces_n || !slot || !has_force) {
        arena->used = mark;
        return;
    }
    int64_t count = touch_play_merge(&former->bricks, &field->bricks, brick, slot, (int64_t)capacity);
    memmove(slot + count, slot + capacity, (size_t)(8 * count));
    touch_blend_bricks(rule, count, 0, count, slot, former->bricks.forces_n, field->bricks.forces_n, forces_n, has_force);
    for (int64_t n = 0; n < count; n++) {
        if (!has_force[n]) continue;
        memmove(brick + 3 * selected, brick + 3 * n, 12);
        memmove(forces_n + TOUCH_BRICK_FLOATS * selected, forces_n + TOUCH_BRICK_FLOATS * n, 4 * TOUCH_BRICK_FLOATS);
        selected++;
    }
    field->bricks.brick = brick, field->bricks.forces_n = forces_n, field->bricks.bricks = selected;
}

/* The weight of a frame against the last one of the segment before; 1: it is not blended. */
static inline double touch_play_weight(touch_play *play, int64_t frame) {
    int64_t count = play->file.frame_count, first = touch_play_first_of(play, frame);
    if (!play->options.blends || count == 1 || play->file.rate_hz <= TOUCH_MAX_UNBLENDED_HZ) return 1.0;
    if (frame == first) {
        touch_play_fields *latest = play->latest;
        play->former_frame = play->latest_frame >= 0 && (play->latest_frame + 1) % count == frame ? play->latest_frame : -1;
        play->latest = play->former, play->former = latest, play->latest_frame = -1;
    } else if (!(first <= play->latest_frame && play->latest_frame < frame)) {
        play->former_frame = -1;
    }
    int64_t length = touch_play_segment_length(play, first, touch_segment_of(&play->file, (uint32_t)frame));
    double weight = touch_blend_weight(play->file.rate_hz, frame - first, length, first + length >= count);
    if (weight == 1.0) play->former_frame = -1;
    return play->former_frame < 0 ? 1.0 : weight;
}

/* -- frames in the memory of the receiver ----------------------------------------------------------------------------- */

/* Count the cells of a field. */
static inline void touch_play_count_cells(touch_play_field *field) {
    field->cell_count = touch_find_cells(&field->bricks, NULL, &field->box, NULL);
}

/* Write the cells of a field at an offset; 0: there is no room for the list of their bricks. */
static inline int touch_play_write_cells(touch_play *play, const touch_play_field *field, int64_t offset,
                                         touch_arena *arena) {
    touch_cells *cells = (touch_cells *)(void *)((char *)play->receiver + offset);
    touch_cell_box box = field->box;
    uint64_t mark = arena->used;
    int32_t *brick = (int32_t *)touch_play_take(arena, 12 * field->cell_count);
    if (!brick) return 0;
    touch_find_cells(&field->bricks, NULL, &box, brick);
    touch_start_cells(cells, &box, brick, field->cell_count, field->grid.spacing_m, field->grid.origin_m);
    touch_fill_cells(cells, &box, brick, 0, field->cell_count, &field->bricks);
    arena->used = mark;
    return 1;
}

/* Decode a frame, and make its fields `latest`: those of bodies that deform, and of the vibration. */
static inline int touch_play_prepare(touch_play *play, int64_t frame) {
    uint64_t parts = touch_play_parts(play);
    if (touch_play_decode_frame(play, frame)) return play->code;
    touch_blend_rule rule = {touch_play_weight(play, frame), 0.0, 0.0};
    touch_play_fields *fields = play->spare;
    touch_arena *arena = &fields->arena;
    const touch_play_field *shared = play->latest->field; /* offsets of rigid bodies are the same in all three */
    arena->used = touch_play_aligned((parts + 1) * sizeof(touch_play_field));
    for (uint64_t n = 0; n <= parts; n++) {
        const touch_field *source = n < parts ? play->frame.part[n].field : play->frame.vibration;
        touch_play_field *field = fields->field + n;
        int64_t cells_offset = n < parts ? shared[n].cells_offset : 0;
        memset(field, 0, sizeof *field);
        if ((field->cells_offset = cells_offset) || !source) continue;
        if (!touch_play_gather(source, arena, field)) return touch_play_fail(play, TOUCH_MEMORY, "no room for a field");
        if (rule.weight < 1.0 && n < parts && touch_mask_of(&play->decoder, (uint32_t)n, &rule.k, &rule.f0_n))
            touch_play_blend(&rule, play->former->field + n, field, arena);
        touch_play_count_cells(field);
    }
    play->spare = play->latest, play->latest = fields, play->latest_frame = frame;
    return TOUCH_OK;
}

static inline uint64_t touch_play_poses_bytes(const touch_play *play) {
    return touch_play_aligned(sizeof(touch_frame_header) + touch_play_parts(play) * sizeof(touch_body_pose));
}

/* Bytes of the latest frame in the ring. */
static inline uint64_t touch_play_frame_bytes(const touch_play *play) {
    uint64_t bytes = touch_play_poses_bytes(play), parts = touch_play_parts(play);
    for (uint64_t n = 0; n < parts + (play->frame.vibration != NULL); n++)
        if (!play->latest->field[n].cells_offset) bytes += touch_cells_room(play->latest->field[n].cell_count);
    return bytes;
}

/* The quaternion of a rotation: the largest of the rows of its products with itself, made unit. */
static inline void touch_play_quaternion(const double r[9], double q[4]) {
    const double rows[4][4] = {{1 + r[0] + r[4] + r[8], r[7] - r[5], r[2] - r[6], r[3] - r[1]},
                               {r[7] - r[5], 1 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6]},
                               {r[2] - r[6], r[1] + r[3], 1 - r[0] + r[4] - r[8], r[5] + r[7]},
                               {r[3] - r[1], r[2] + r[6], r[5] + r[7], 1 - r[0] - r[4] + r[8]}};
    double square = 0.0;
    int largest = 0;
    for (int n = 1; n < 4; n++)
        if (rows[n][n] > rows[largest][largest]) largest = n;
    for (int n = 0; n < 4; n++) square += rows[largest][n] * rows[largest][n];
    for (int n = 0; n < 4; n++) q[n] = rows[largest][n] / sqrt(square);
}

static inline void touch_play_write_pose(const touch_play *play, const touch_part *part, int64_t cells_offset,
                                         touch_body_pose *pose) {
    double damping = play->frame.surface_damping_n_s_per_m;
    const double *r = part->rotation, *v = part->velocity_m_s, *w = part->spin_rad_s, *p = part->position_m;
    memset(pose, 0, sizeof *pose);
    pose->cells_offset = cells_offset;
    if (!play->frame.is_placed) {
        pose->is_identity = 1, pose->quaternion[0] = 1.0;
        pose->rotation.row[0].x = pose->rotation.row[1].y = pose->rotation.row[2].z = 1.0;
        return;
    }
    touch_play_quaternion(r, pose->quaternion);
    pose->position_m = touch_vector_of(p[0], p[1], p[2]);
    pose->surface_damping_n = touch_vector_of(damping * v[0], damping * v[1], damping * v[2]);
    pose->surface_damping_n_per_m = touch_vector_of(damping * w[0], damping * w[1], damping * w[2]);
    for (int n = 0; n < 3; n++) pose->rotation.row[n] = touch_vector_of(r[3 * n], r[3 * n + 1], r[3 * n + 2]);
}

/* Damper and coupling for a frame that is stiffer than those before. */
static inline void touch_play_adapt(touch_play *play, double stiffness_n_per_m) {
    if (stiffness_n_per_m <= play->stiffest_n_per_m) return;
    play->stiffest_n_per_m = stiffness_n_per_m;
    touch_choose_stability(&play->receiver->settings, &play->options.render, &play->options.device,
                           play->file.damping_n_s_per_m, stiffness_n_per_m);
}

/* Write the latest frame at an offset; the offset of its header. A proxy's walls need no slopes. */
static inline int64_t touch_play_write_frame(touch_play *play, int64_t offset) {
    touch_play_fields *fields = play->latest;
    uint64_t parts = touch_play_parts(play);
    char *memory = (char *)play->receiver;
    int64_t at = offset + (int64_t)touch_play_poses_bytes(play);
    touch_frame_header *header = (touch_frame_header *)(void *)(memory + offset);
    touch_body_pose *pose = (touch_body_pose *)(void *)(header + 1);
    memset(header, 0, sizeof *header);
    header->body_count = (int64_t)parts;
    header->force_max_n = play->frame.is_placed ? play->frame.force_max_n : (double)INFINITY;
    double floor_n = play->frame.is_placed ? play->frame.force_max_n * TOUCH_PLAY_FLOOR_FRACTION : 0.0;
    header->force_floor2_n2 = floor_n * floor_n;
    for (uint64_t n = 0; n < parts + (play->frame.vibration != NULL); n++) {
        const touch_play_field *field = fields->field + n;
        int64_t cells_offset = field->cells_offset ? field->cells_offset : at;
        if (!field->cells_offset) {
            if (!touch_play_write_cells(play, field, at, &fields->arena)) {
                touch_play_fail(play, TOUCH_MEMORY, "no room for the cells of a field");
                return 0;
            }
            const touch_cells *cells = (const touch_cells *)(const void *)(memory + at);
            if (n < parts && !(play->wall.stiffness_n_per_m > 0.0))
                touch_play_adapt(play, touch_stiffest_n_per_m(cells, (int64_t)field->cell_count));
            at += (int64_t)touch_cells_room(field->cell_count);
        }
        if (n < parts) touch_play_write_pose(play, play->frame.part + n, cells_offset, pose + n);
        else header->vibration_offset = cells_offset;
    }
    return offset;
}

/* -- the ring of frames ----------------------------------------------------------------------------------------------- */

static inline touch_play_slot *touch_play_slot_at(touch_play *play, int64_t n) {
    return play->slot + ((play->first_slot + n) & (play->options.max_ahead - 1));
}

/* Free the room of all frames before `frame`. */
static inline void touch_play_free_before(touch_play *play, int64_t frame) {
    while (play->slots && touch_play_slot_at(play, 0)->frame < frame) play->first_slot++, play->slots--;
    if (!play->slots) play->head = play->ring_start;
}

/* Room for a frame in one piece; 0: there is none now. */
static inline int64_t touch_play_room_for(touch_play *play, int64_t frame, int64_t bytes) {
    int64_t oldest = play->slots ? touch_play_slot_at(play, 0)->offset : play->ring_stop, offset;
    int is_wrapped = play->slots && play->head <= oldest;
    if (play->slots == play->options.max_ahead) return 0;
    if (bytes <= (is_wrapped ? oldest : play->ring_stop) - play->head) offset = play->head;
    else if (!is_wrapped && play->slots && bytes <= oldest - play->ring_start) offset = play->ring_start;
    else return 0;
    touch_play_slot *slot = touch_play_slot_at(play, play->slots++);
    slot->frame = frame, slot->offset = offset;
    play->head = offset + bytes;
    return offset;
}

/* -- starting --------------------------------------------------------------------------------------------------------- */

/* The wall of a field whose cells lie at an offset; the fields of bodies may make one stiffer. */
static inline int touch_play_add_wall(touch_play *play, const touch_play_field *field, int64_t cells_offset) {
    const touch_cells *cells = (const touch_cells *)(const void *)((char *)play->receiver + cells_offset);
    touch_wall_field source = {&field->bricks, cells, field->grid.spacing_m, field->grid.origin_m};
    touch_arena *work = &play->former->arena; /* not in use yet */
    work->used = touch_play_aligned((touch_play_parts(play) + 1) * sizeof(touch_play_field));
    double *sizes = (double *)touch_play_take(work, 8 * (uint64_t)touch_force_sizes(&field->bricks, NULL));
    if (!sizes) return touch_play_fail(play, TOUCH_MEMORY, "no room to look for walls");
    touch_field_wall wall = touch_find_wall(&source, sizes);
    if (!(wall.stiffness_n_per_m > 0.0)) return TOUCH_OK;
    touch_settings *settings = &play->receiver->settings;
    const double *h = field->grid.spacing_m;
    double finest = touch_fmin(touch_fmin(h[0], h[1]), h[2]), before = settings->wall_spacing_m.x;
    if (before > 0.0) finest = touch_fmin(finest, before);
    int is_first = !(play->wall.stiffness_n_per_m > 0.0);
    play->wall.level_n = is_first ? wall.level_n : touch_fmin(wall.level_n, play->wall.level_n);
    play->wall.large_n = touch_fmax(play->wall.large_n, wall.large_n);
    play->wall.stiffness_n_per_m = touch_fmax(play->wall.stiffness_n_per_m, wall.stiffness_n_per_m);
    settings->wall_spacing_m = touch_vector_of(finest, finest, finest); /* bodies rotate */
    if (touch_play_parts(play) == 1) settings->wall_spacing_m = touch_vector_of(h[0], h[1], h[2]);
    return TOUCH_OK;
}

/* Write the cells of the latest frame's body n where frames will be; its offset, 0: there is no room. */
static inline int64_t touch_play_write_first(touch_play *play, uint64_t n) {
    const touch_play_field *field = play->latest->field + n;
    int64_t offset = play->ring_start;
    if ((int64_t)touch_cells_room(field->cell_count) <= play->ring_stop - offset &&
        touch_play_write_cells(play, field, offset, &play->latest->arena))
        return offset;
    touch_play_fail(play, TOUCH_MEMORY, "no room for the fields of a frame: raise frames_bytes");
    return 0;
}

/* Look for walls in the fields of a frame. */
static inline int touch_play_find_walls(touch_play *play, int64_t frame) {
    if (touch_play_prepare(play, frame)) return play->code;
    for (uint64_t n = 0; n < touch_play_parts(play); n++) {
        int64_t offset = touch_play_write_first(play, n);
        if (!offset || touch_play_add_wall(play, play->latest->field + n, offset)) return play->code;
    }
    return TOUCH_OK;
}

/* Choose the proxy's walls, if there is to be one: those of the first frame, else of the middle one. */
static inline int touch_play_choose_walls(touch_play *play) {
    const touch_render_options *render = &play->options.render;
    touch_settings *settings = &play->receiver->settings;
    int64_t middle = play->file.frame_count / 2;
    if (render->rendering == TOUCH_RENDER_FIELD) return TOUCH_OK;
    if (render->rendering == TOUCH_RENDER_AUTO && render->coupling_n_per_m > 0.0) return TOUCH_OK;
    if (touch_play_find_walls(play, 0)) return play->code;
    if (!(play->wall.stiffness_n_per_m > 0.0) && middle && touch_play_find_walls(play, middle)) return play->code;
    if (!(play->wall.stiffness_n_per_m > 0.0)) {
        if (render->rendering == TOUCH_RENDER_AUTO) return TOUCH_OK;
        return touch_play_fail(play, TOUCH_ARGUMENT, "a field without walls has no proxy");
    }
    double stated_n_per_m = touch_stated_wall(play->file.provenance.bytes, play->file.provenance.size);
    if (stated_n_per_m > 0.0) play->wall.stiffness_n_per_m = stated_n_per_m;
    if (render->wall_n_per_m > 0.0) play->wall.stiffness_n_per_m = render->wall_n_per_m;
    settings->wall_n_per_m = play->wall.stiffness_n_per_m, settings->wall_level_n = play->wall.level_n;
    settings->wall_force_n = play->wall.large_n;
    touch_play_adapt(play, play->wall.stiffness_n_per_m);
    return TOUCH_OK;
}

/* Write the cells of rigid bodies, which all frames share. */
static inline int touch_play_write_shared(touch_play *play) {
    if (touch_play_prepare(play, 0)) return play->code;
    for (uint64_t n = 0; n < touch_play_parts(play); n++) {
        if (!touch_is_rigid(&play->decoder, (uint32_t)n)) continue;
        int64_t offset = touch_play_write_first(play, n);
        if (!offset) return play->code;
        const touch_cells *cells = (const touch_cells *)(const void *)((char *)play->receiver + offset);
        int64_t count = (int64_t)play->latest->field[n].cell_count;
        if (!(play->wall.stiffness_n_per_m > 0.0)) touch_play_adapt(play, touch_stiffest_n_per_m(cells, count));
        play->ring_start += (int64_t)touch_cells_room((uint64_t)count);
        for (int k = 0; k < 3; k++) play->fields[k].field[n].cells_offset = offset;
    }
    return TOUCH_OK;
}

/* The index of a body by its name. */
static inline int64_t touch_play_find_body(const void *context, touch_stated_text name) {
    const touch_decoder *decoder = (const touch_decoder *)context;
    for (uint32_t n = 0; n < decoder->file->object_count; n++) {
        touch_bytes body = touch_name_of(decoder, n);
        if (touch_json_is_name(name, body.bytes, body.size)) return n;
    }
    return -1;
}

/* Write the materials that are stored with the medium, in front of the arena. */
static inline int touch_play_write_materials(touch_play *play) {
    int64_t offset = play->receiver->layout.arena_offset - (int64_t)touch_play_materials_room(play);
    int is_of_medium = play->options.render.friction < 0.0;
    if (!TOUCH_HAS_EXTRAS || !play->materials.at) return TOUCH_OK;
    if (touch_write_materials(play->receiver, offset, play->materials, is_of_medium, touch_play_find_body, &play->decoder))
        return TOUCH_OK;
    return touch_play_fail(play, TOUCH_CORRUPT, "materials that are damaged, or of an object that is not there");
}

/* Lay out the receiver: struct, directory, log, materials, arena. */
static inline void touch_play_lay_out(touch_play *play) {
    const touch_play_options *options = &play->options;
    touch_receiver *receiver = play->receiver;
    touch_receiver_layout *layout = &receiver->layout;
    memset(receiver, 0, sizeof *receiver);
    layout->version = TOUCH_RECEIVER_VERSION, layout->size_bytes = (int64_t)touch_play_receiver_room(play);
    layout->directory_offset = (int64_t)touch_play_aligned(sizeof *receiver), layout->directory_slots = options->max_ahead;
    layout->log_offset = layout->directory_offset +
                         (int64_t)touch_play_aligned((uint64_t)options->max_ahead * sizeof(touch_directory_entry));
    layout->log_rows = options->log_rows;
    layout->arena_offset = layout->log_offset + (int64_t)touch_play_materials_room(play) +
                           (int64_t)touch_play_aligned((uint64_t)options->log_rows * sizeof(touch_log_row));
    layout->frame_count = play->file.frame_count, layout->frame_rate_hz = play->file.rate_hz;
    layout->is_loop = options->is_loop && play->file.frame_count > 1, layout->is_unblended = !options->blends;
    layout->tick_ns = (int64_t)(1e9 / options->render.rate_hz + 0.5), layout->is_simulated = options->is_simulated;
    touch_directory_entry *entries = (touch_directory_entry *)(void *)((char *)receiver + layout->directory_offset);
    for (int64_t n = 0; n < layout->directory_slots; n++) entries[n].tag = -1, entries[n].frame_offset = 0;
    receiver->clock.is_resting = 1, receiver->clock.sequence_seen = receiver->clock.used = -1;
    play->ring_start = layout->arena_offset, play->ring_stop = layout->size_bytes;
}

/* Divide the memory; a decoder, an arena for its frames, and three for fields. */
static inline int touch_play_divide(touch_play *play, void *memory) {
    uint64_t decoder_room, frame_room, shift = (uint64_t)(uintptr_t)memory % TOUCH_PLAY_ALIGNMENT;
    touch_arena all = touch_arena_of((uint8_t *)memory + (shift ? TOUCH_PLAY_ALIGNMENT - shift : 0), touch_play_room(play));
    touch_room(&play->file, &decoder_room, &frame_room);
    uint64_t fields_room = touch_play_fields_room(play, decoder_room, frame_room);
    uint64_t fields_start = touch_play_aligned((touch_play_parts(play) + 1) * sizeof(touch_play_field));
    play->receiver = (touch_receiver *)touch_play_take(&all, touch_play_receiver_room(play));
    play->slot = (touch_play_slot *)touch_play_take(&all, (uint64_t)play->options.max_ahead * sizeof(touch_play_slot));
    play->frame_arena = touch_arena_of(touch_play_take(&all, frame_room), frame_room);
    for (int n = 0; n < 3; n++) {
        play->fields[n].arena = touch_arena_of(touch_play_take(&all, fields_room), fields_room);
        play->fields[n].field = (touch_play_field *)(void *)play->fields[n].arena.base;
        memset(play->fields[n].field, 0, (size_t)fields_start);
    }
    play->former = play->fields, play->latest = play->fields + 1, play->spare = play->fields + 2;
    touch_arena decoder_arena = touch_arena_of(touch_play_take(&all, decoder_room), decoder_room);
    int code = touch_start(&play->decoder, &play->file, decoder_arena);
    return code ? touch_play_fail(play, code, play->decoder.error) : TOUCH_OK;
}

/* The media time for a seek: past the end it wraps in a loop, and otherwise is the end. */
static inline double touch_play_media_time(const touch_play *play, double time_s) {
    double seconds = play->file.frame_count / play->file.rate_hz;
    if (!(time_s > 0.0) || play->file.frame_count == 1) return 0.0;
    return play->receiver->layout.is_loop ? fmod(time_s, seconds) : touch_fmin(time_s, seconds);
}

/* Whether the options are ones that can be played. */
static inline int touch_play_check(const touch_play *play) {
    const touch_play_options *o = &play->options;
    const touch_render_options *render = &o->render;
    return o->max_ahead >= 4 && !(o->max_ahead & (o->max_ahead - 1)) && o->max_ahead <= 1 << 14 && o->log_rows >= 0 &&
           o->speed > 0.0 && o->speed <= 100.0 && render->rate_hz >= 10.0 && render->rate_hz <= 20000.0 &&
           render->scale > 0.0 && render->force_scale >= 0.0 && render->thermal_s > 0.0 && render->ramp_s > 0.0 &&
           render->velocity_cutoff_hz > 0.0;
}

static inline int touch_play_set_up(touch_play *play, void *memory) {
    if (!memory) return touch_play_fail(play, TOUCH_MEMORY, "no memory");
    if (touch_play_choose_force_max(play)) return play->code;
    if (!touch_play_check(play)) return touch_play_fail(play, TOUCH_ARGUMENT, "options that cannot be played");
    play->decoded = play->latest_frame = play->former_frame = play->pace.latest = -1, play->generation = 1;
    if (touch_play_divide(play, memory)) return play->code;
    touch_play_lay_out(play);
    touch_receiver *receiver = play->receiver;
    touch_choose_settings(receiver, &play->options.render, &play->options.device, play->file.friction,
                          play->file.damping_n_s_per_m);
    if (touch_play_write_materials(play) || touch_play_choose_walls(play) || touch_play_write_shared(play)) return play->code;
    play->decoded = play->latest_frame = play->former_frame = -1, play->head = play->ring_start;
    double start_s = touch_play_media_time(play, play->options.start_s);
    play->next = touch_unrolled_frame(start_s, play->file.rate_hz);
    receiver->clock.media_s = start_s, receiver->clock.needs = touch_tag(1, play->next);
    touch_give_order(receiver, 1, start_s, play->options.speed, TOUCH_IDLE, 0);
    return TOUCH_OK;
}

/* Lay out the receiver in memory of touch_play_room bytes, decode the first frame, and choose the settings for the device.
   TOUCH_OK, or play->code and play->error, and no receiver. The servo may tick from then on; it renders no force before
   touch_play_resume. */
static inline int touch_play_start(touch_play *play, void *memory) {
    if (!play->code && touch_play_set_up(play, memory)) play->receiver = NULL;
    return play->code;
}

/* -- the thread that decodes ------------------------------------------------------------------------------------------ */

/* Frames that must be decoded for an unrolled frame: from the latest one on, or from the start of its segment. */
static inline int64_t touch_play_decode_count(const touch_play *play, int64_t frame) {
    int64_t index = frame % play->file.frame_count, latest = play->pace.latest;
    int64_t start = frame - index + touch_play_first_of(play, index);
    return frame - (start <= latest && latest < frame ? latest : start - 1);
}

/* Note that an unrolled frame was decoded, at the times of the latest ticks before and after. The first frame tells nothing:
   it is perhaps the first use of code and memory. */
static inline void touch_play_note_duration(touch_play *play, int64_t frame, int64_t before_ns, int64_t after_ns) {
    touch_play_pace *pace = &play->pace;
    if (pace->latest >= 0 && before_ns) {
        double seconds = 0.0, frames = 0.0;
        int64_t n = pace->count++ % TOUCH_PLAY_DURATIONS;
        pace->seconds[n] = 1e-9 * (double)(after_ns - before_ns), pace->frames[n] = touch_play_decode_count(play, frame);
        for (n = 0; n < pace->count && n < TOUCH_PLAY_DURATIONS; n++)
            seconds += pace->seconds[n], frames += (double)pace->frames[n];
        pace->frame_s = seconds / frames;
    }
    pace->latest = frame;
}

#define TOUCH_PLAY_TIME_MARGIN 1.5 /* time that must be left to start a frame, over its expected time */

/* The first frame, before `stop`, that can be ready at its time; else `stop` if the medium ends there, or the next one. */
static inline int64_t touch_play_first_reachable(const touch_play *play, int64_t stop) {
    const touch_receiver *receiver = play->receiver;
    double media_s = touch_shared_double(&receiver->clock.media_s), speed = touch_shared_double(&receiver->clock.speed);
    if (play->pace.frame_s <= 0.0) return play->next;
    for (int64_t frame = play->next; frame < stop; frame++) {
        double left_s = ((double)frame / play->file.rate_hz - media_s) / speed;
        if (TOUCH_PLAY_TIME_MARGIN * play->pace.frame_s * (double)touch_play_decode_count(play, frame) <= left_s) return frame;
    }
    return !receiver->layout.is_loop && stop == receiver->layout.frame_count ? stop : play->next;
}

/* Count frames that are left out. */
static inline void touch_play_leave_out(touch_play *play, int64_t frames) {
    touch_share(&play->left_out, play->left_out + frames);
}

/* Show the previous frame in place of those that cannot be ready in time. 0: no frame is left. */
static inline int touch_play_drop_late(touch_play *play, int64_t needed) {
    touch_receiver *receiver = play->receiver;
    int64_t feed = touch_shared(&receiver->clock.feed), stop = needed + receiver->layout.directory_slots - 1;
    int64_t is_loop = receiver->layout.is_loop, count = receiver->layout.frame_count;
    int is_complete = play->options.is_complete || receiver->layout.is_simulated;
    if (is_complete || touch_shared(&receiver->clock.mode) != TOUCH_PLAYING) return 1;
    if (feed != TOUCH_RUNNING && feed != TOUCH_STALLED) return 1;
    if (!is_loop && count < stop) stop = count;
    int64_t frame = touch_play_first_reachable(play, stop);
    if (frame > play->next) {
        touch_play_slot *slot = play->slots ? touch_play_slot_at(play, play->slots - 1) : NULL;
        if (slot && slot->frame < frame) slot->frame = frame - 1; /* until then it is not overwritten */
        for (int64_t n = play->next; slot && n < frame; n++) touch_publish(receiver, play->generation, n, slot->offset);
        touch_play_leave_out(play, frame - play->next);
        play->next = frame;
    }
    return is_loop || frame < count;
}

/* Follow a seek: a new generation of frames. 0: the order is being written. */
static inline int touch_play_follow_orders(touch_play *play) {
    touch_orders orders;
    if (!touch_read_orders(play->receiver, &orders)) return 0;
    if (orders.generation == play->generation) return 1;
    play->generation = orders.generation, play->next = touch_unrolled_frame(orders.start_s, play->file.rate_hz);
    play->is_ready = play->is_published = 0, play->latest_frame = play->former_frame = -1;
    play->slots = 0, play->head = play->ring_start;
    return 1;
}

/* Write the latest frame into the ring, and show it; 0: there is no room now. */
static inline int touch_play_publish(touch_play *play, int64_t needed) {
    int64_t bytes = (int64_t)touch_play_frame_bytes(play);
    touch_play_free_before(play, needed);
    int64_t offset = touch_play_room_for(play, play->next, bytes);
    if (!offset) { /* the servo waits for one of two frames, and frees none */
        if (play->next <= needed + 1)
            touch_play_fail(play, TOUCH_MEMORY, "no room for two frames: raise frames_bytes");
        return 0;
    }
    offset = touch_play_write_frame(play, offset);
    if (!offset) return 0;
    touch_publish(play->receiver, play->generation, play->next, offset);
    play->next++, play->is_ready = 0, play->is_published = 1;
    return 1;
}

/* Decode the next frame, and measure how long that takes. */
static inline int touch_play_prepare_next(touch_play *play) {
    const int64_t *clock_ns = &play->receiver->counts.last_ns;
    int64_t before_ns = touch_shared(clock_ns);
    if (touch_play_prepare(play, play->next % play->file.frame_count)) return 0;
    touch_play_note_duration(play, play->next, before_ns, touch_shared(clock_ns));
    return play->is_ready = 1;
}

static inline int touch_play_step(touch_play *play) {
    touch_receiver *receiver = play->receiver;
    if (!touch_play_follow_orders(play)) return 0;
    int64_t needs = touch_shared(&receiver->clock.needs), needed = needs & (((int64_t)1 << TOUCH_FRAME_BITS) - 1);
    int64_t count = receiver->layout.frame_count;
    int is_accepted = needs >> TOUCH_FRAME_BITS == play->generation;
    if (is_accepted && needed > play->next) { /* the servo has passed these */
        if (play->is_published) touch_play_leave_out(play, needed - play->next);
        play->next = needed, play->is_ready = 0;
    }
    if (!receiver->layout.is_loop && play->next >= count) return 0;
    if (is_accepted && play->next >= needed + receiver->layout.directory_slots - 1) return 0;
    if (!play->is_ready) {
        if (is_accepted && !touch_play_drop_late(play, needed)) return 1;
        if (!touch_play_prepare_next(play)) return 0;
    }
    return is_accepted && touch_play_publish(play, needed);
}

/* Decode one frame, and show it to the servo. 0: there is nothing to be done now, or it has failed (play->code); then the
   servo plays what is there, and the force goes to zero. To be called at least once a second: it is a sign of life, too. */
static inline int touch_play_decode(touch_play *play) {
    touch_play_beat(play);
    if (play->code) return 0;
    int is_done = touch_play_step(play);
    if (play->code) touch_share(&play->receiver->orders.has_feed_failed, 1);
    return is_done;
}

/* Whether a tick at `now_ns` finds its frames, or none will come, and a sign of life of the thread that decodes. For a servo
   that may wait, as one of simulated time; the tick is at most one frame later than the one before, and three frames have room
   in `frames_bytes`. */
static inline int touch_play_is_ready(const touch_play *play, int64_t now_ns) {
    touch_receiver *receiver = play->receiver;
    const touch_clock *clock = &receiver->clock;
    int64_t count = receiver->layout.frame_count, frame = 0, following = 0, ticks = receiver->counts.ticks;
    int64_t generation = clock->needs >> TOUCH_FRAME_BITS;
    double clock_s = ticks ? 1e-9 * (double)(now_ns - receiver->counts.first_ns) : 0.0;
    if (touch_shared(&receiver->orders.has_feed_failed)) return 1;
    if (touch_shared(&receiver->orders.is_stopping)) return 1; /* the way to zero needs no frame */
    if (touch_feed_silence_ns(receiver, now_ns) > TOUCH_MAX_SILENCE_NS) return 0;
    if (touch_shared(&receiver->orders.generation) != generation) return 1; /* frames come after the tick that takes it */
    if (receiver->layout.is_simulated) clock_s = (double)ticks / receiver->settings.rate_hz;
    if (count > 1) {
        frame = touch_unrolled_frame(touch_media_time(clock, clock_s), receiver->layout.frame_rate_hz);
        if (!receiver->layout.is_loop && frame >= count) return 1;
        following = frame == count - 1 && !receiver->layout.is_loop ? frame : frame + 1;
    }
    return touch_shared(&touch_slot_of(receiver, frame)->tag) == touch_tag(generation, frame) &&
           touch_shared(&touch_slot_of(receiver, following)->tag) == touch_tag(generation, following);
}

/* -- orders, from one thread ------------------------------------------------------------------------------------------ */

static inline void touch_play_order(touch_play *play, int64_t mode, int64_t is_stopping) {
    const touch_orders *orders = &play->receiver->orders;
    touch_give_order(play->receiver, orders->generation, orders->start_s, orders->speed, mode, is_stopping);
}

static inline void touch_play_resume(touch_play *play) { touch_play_order(play, TOUCH_PLAYING, 0); }

/* The medium stands; its force can be felt. */
static inline void touch_play_pause(touch_play *play) { touch_play_order(play, TOUCH_PAUSED, 0); }

/* Bring the force to zero for ever; clock.is_released says when it is there. */
static inline void touch_play_stop(touch_play *play) { touch_play_order(play, play->receiver->orders.mode, 1); }

/* Go on at a media time, seconds. */
static inline void touch_play_seek(touch_play *play, double time_s) {
    const touch_orders *orders = &play->receiver->orders;
    touch_give_order(play->receiver, orders->generation + 1, touch_play_media_time(play, time_s), orders->speed, orders->mode,
                     0);
}

/* Why it plays no longer, or the thread that decodes is taken for dead; "": all is well. For any thread. */
static inline const char *touch_play_error(const touch_play *play) {
    const touch_receiver *receiver = play->receiver;
    if (!receiver) return play->error;
    int has_failed = touch_shared(&receiver->orders.has_feed_failed) != 0;
    TOUCH_FENCE();
    if (has_failed) return play->error;
    return touch_shared(&receiver->clock.is_silent) ? "the thread that decodes gives no sign of life" : "";
}

/* Whether nothing is left to render and the force is zero. */
static inline int touch_play_is_over(const touch_play *play) {
    const touch_clock *clock = &play->receiver->clock;
    const touch_orders *orders = &play->receiver->orders;
    if (touch_shared(&clock->sequence_seen) != orders->sequence) return 0;
    int64_t feed = touch_shared(&clock->feed);
    int is_starved = feed == TOUCH_STALLED || feed == TOUCH_WAITING || touch_shared(&clock->mode) != TOUCH_PLAYING;
    return (feed == TOUCH_ENDED || (touch_shared(&orders->has_feed_failed) && is_starved)) &&
           touch_shared(&clock->is_resting);
}

#endif
