/* touch_receiver.h: the memory of a receiver, as structs with named fields. A program that decodes writes frames,
   settings and orders into it; the servo reads them at each tick and writes its state, counts and log. Both may be
   threads of one program, or processes that share the memory.

   This header is the only table of the layout. Every number has eight bytes, so that the layout is the same for every
   compiler; Python reads and writes it through types that are generated from this file (c/python/receiver_layout.py).
   An `..._offset` counts bytes from the first byte of the receiver, unless its comment says otherwise; 0 means none. Each
   field has one writer. */
#ifndef TOUCH_RECEIVER_H
#define TOUCH_RECEIVER_H

#include "touch_vector.h"

#include <stdint.h>

enum { TOUCH_RECEIVER_VERSION = 4 };

/* A program that plays files alone may define it as 0: files have no deformations, materials or tools, whose code is left
   out then. */
#ifndef TOUCH_HAS_EXTRAS
#define TOUCH_HAS_EXTRAS 1
#endif

/* -- a field of forces, in cells -------------------------------------------------------------------------------------- */

/* A lattice of forces in bricks of 8 x 8 x 8 cells. A cell has eight corners, so that a brick stores 9 x 9 x 9 samples and
   a query reads one brick only. Behind this header lie, at offsets from its first byte, the hash table int64
   [2^table_bits][2] of brick number and index (-1: a free entry), the bits uint64 [n][8] of cells with a force at any
   corner, and the samples float [n][9][9][9][3], newtons. */
typedef struct {
    int64_t brick_count[3];      /* of the box along x, y, z; 0 for a field without a force */
    int64_t table_shift;         /* 64 - table_bits */
    int64_t table_offset, supported_offset, samples_offset;
    touch_vector samples_per_m;
    touch_vector corner_m;       /* of the box, in the frame of the field's body */
    double reach2_m2;            /* square of the distance from the body's origin within which all forces lie; or -1 */
    int64_t reserved[2];
} touch_cells;

/* A body in a frame; body n of two successive frames is the same body. Voxels are one body that is not moved. */
typedef struct {
    int64_t cells_offset;
    int64_t is_identity;         /* neither rotated nor moved, in any frame */
    double quaternion[4];        /* scene from body, unit, w first */
    touch_vector position_m;
    touch_vector surface_damping_n; /* velocity times surface damping */
    touch_vector surface_damping_n_per_m; /* angular velocity times surface damping */
    touch_matrix rotation;       /* of the quaternion */
} touch_body_pose;

/* A frame; its bodies lie behind it, then its deformation. */
typedef struct {
    int64_t body_count;
    int64_t vibration_offset;    /* of the cells of the vibration: amplitude, N, frequency, Hz, and 0 at each sample */
    double force_max_n;          /* the sum of forces is clipped to it */
    double force_floor2_n2;      /* square of the force of a body below which it counts as none */
    int64_t deformation_offset;  /* from the first byte of the frame */
    int64_t is_seam;             /* it need not go on from the frame before, as one of another layer (touch_seam.h) */
} touch_frame_header;

/* The displacements of the control points of a cubic B-spline, which bend the field. They lie behind it: double
   [nx][ny][nz][3], metres. */
typedef struct {
    int64_t point_count[3];
    int64_t yield_offset;        /* of displacements that follow the force, double [nx][ny][nz][3]; 0: it does not yield */
    touch_vector corner_m;       /* of the first cell */
    touch_vector cells_per_m;
    double compliance_m_per_n, relaxation_s, max_yield_m;
} touch_deformation;

/* -- what does not change while it plays ------------------------------------------------------------------------------ */

typedef struct {
    int64_t version, size_bytes;
    int64_t directory_offset, directory_slots; /* touch_directory_entry [slots]; a power of two */
    int64_t log_offset, log_rows; /* touch_log_row [rows], a ring */
    int64_t arena_offset;        /* where frames are written */
    int64_t frame_count;
    double frame_rate_hz;
    int64_t is_loop;
    int64_t tick_ns;
    int64_t ramp_limit_ns;       /* the longest time that a force may need to become zero */
    int64_t is_simulated;        /* time is the number of the tick divided by the rate */
    int64_t is_paced;            /* a driver calls: the next deadline follows its call */
    int64_t is_unblended;        /* the force steps where the medium does not go on: no fade (touch_seam.h) */
    int64_t reserved[1];
} touch_receiver_layout;

typedef struct { /* where a frame lies; `tag` is written last */
    int64_t tag;                 /* generation << TOUCH_FRAME_BITS | unrolled frame; -1: none */
    int64_t frame_offset;
} touch_directory_entry;

enum { TOUCH_FRAME_BITS = 40 }; /* of an unrolled frame, which counts on in a loop; a generation stands above them */

typedef struct {
    double peak, continuous;     /* 0: no continuous limit */
    double slew_per_s;
} touch_limits;

typedef struct { /* what the user and the device want; units in the names */
    double rate_hz;
    double friction;             /* mu of the medium */
    double damping_n_s_per_m;
    double stick_n_per_m;        /* spring of friction's anchor, and its damper */
    double stick_n_s_per_m;
    double coupling_n_per_m;     /* K of the virtual coupling; 0: none */
    double brake_n_s_per_m;      /* of the damper in contact, along the force of the field */
    int64_t is_passive;          /* the passivity controller is on */
    double scale;                /* metres of the field for a metre of the device */
    touch_vector clutch_m;       /* of the field, where the device's origin lies */
    double force_scale;
    touch_vector gravity_n;      /* compensates the weight of the handle, in the device's axes */
    touch_matrix axes;           /* rotates a vector of the device into one of the field */
    double handedness;           /* of the axes: 1 or -1 */
    double thermal_s, ramp_s;
    double velocity_cutoff_rad_s;
    double delay_ticks;          /* from a force to its effect on the hand, perhaps a fraction; at most TOUCH_MAX_DELAY */
    double wall_n_per_m;         /* stiffness of the proxy's walls; 0: the field is rendered as it is */
    double wall_level_n;         /* force that defines the surface */
    double wall_force_n;         /* a large force of the field: near its limit */
    touch_vector wall_spacing_m; /* of the samples */
    touch_limits force_limits;   /* N, N/s */
    touch_limits torque_limits;  /* N m, N m/s; 0: the device shows no torque */
    int64_t material_offset, material_count;
    int64_t tool_offset, tool_point_count; /* 0 points: the hand is a point */
    double tool_weight;          /* of a point that faces its force */
    double tool_reach_m;         /* of its farthest point */
} touch_settings;

enum { TOUCH_MAX_DELAY = 4, TOUCH_PAST_FORCES = 6 };

/* -- orders of the player --------------------------------------------------------------------------------------------- */

enum { TOUCH_IDLE, TOUCH_PLAYING, TOUCH_PAUSED };                            /* modes */
enum { TOUCH_READY, TOUCH_WAITING, TOUCH_RUNNING, TOUCH_STALLED, TOUCH_ENDED }; /* states of the feed */

typedef struct { /* `sequence` is odd while the five after it are written; a stop is for ever */
    int64_t sequence;
    int64_t generation;          /* rises with each seek */
    double start_s;              /* media time at which it begins */
    double speed;
    int64_t mode, is_stopping;
    int64_t heartbeat_ns;        /* when the player was last alive, by the servo's clock; 0: nobody looks */
    int64_t feed_heartbeat;      /* rises while the thread that decodes is alive; 0: nobody looks */
    int64_t has_feed_failed;
} touch_orders;

/* -- state of the servo ----------------------------------------------------------------------------------------------- */

typedef struct { /* the media clock and the feed of frames */
    int64_t needs;               /* tag of the first frame that the servo may still read */
    int64_t feed;
    int64_t is_resting;          /* the latest force was zero */
    int64_t is_released;         /* a stop has brought it to zero, which it stays */
    int64_t is_stopping;         /* the servo's own stop, as after a signal */
    int64_t deadline_ns;
    int64_t log_written;         /* rows since the start */
    double media_s;
    int64_t sequence_seen, generation;
    double speed;
    int64_t mode, is_stop_ordered;
    double anchor_media_s, anchor_clock_s;
    double clock_s;
    int64_t used;                /* tag of the frame that was used last */
    int64_t is_silent;           /* the player, or the thread that decodes, gives no sign of life */
    int64_t feed_heartbeat_seen, feed_silence_ns; /* the latest, and the time since it rose */
} touch_clock;

typedef struct { /* what the device reports besides its position */
    double orientation[4];       /* unit quaternion, w first: the device's axes from those of the grip */
    int64_t buttons;             /* bit n is button n */
    double gripper_m;
} touch_grip;

typedef struct { /* of a force, N, or a torque, N m, that is limited */
    touch_vector output;         /* what the device got, in its axes */
    touch_vector desired;        /* before gain and limits */
    double heat;                 /* low-pass of |output|^2 */
    double limit;                /* of |output| at present */
} touch_limited;

typedef struct { /* of a hand at the proxy about its mean, for the damper of touch_proxy_damping.h */
    touch_vector pushed_n;       /* the force on the hand in the tick before, without vibration */
    touch_vector force_n;        /* low-passed */
    touch_vector space_m_s, beside_m_s; /* velocity in space and beside the surface, low-passed */
    touch_vector mean_n, mean_m_s; /* of that force, and of the velocity in space */
    touch_vector turn_n;         /* where the force swung to last, from its mean */
    double turns;                /* of swings lately */
    double work_j;               /* that the hand did on swings of the force, less what it got back */
    double spring_j;             /* what a spring K holds at such a swing, mean */
    double damping;              /* 0 to 1: how much of the damper acts */
} touch_swing;

typedef struct { /* the proxy, or the other end of the virtual coupling */
    int64_t is_active;
    touch_vector position_m;
    int64_t is_in_contact;       /* a surface stops it */
    int64_t body;                /* that carries it; -1: none */
    touch_vector body_position_m; /* in the axes of that body */
    double step_m;               /* at which the search of the tick before ended */
    double surface_n;            /* |F| where it ended */
    double released_s;           /* since no surface stops it where it hangs, away from the hand */
    touch_vector stored_n, force_n; /* at the hand; of the proxy */
    touch_vector eased_n;        /* what jumps of the proxy added to its force and the hand has not got yet */
    touch_swing swing;
    touch_vector coupling_step_m, coupling_pull_n, hand_m; double added_n_per_m; /* in the tick before; hand_m of both */
} touch_proxy;

typedef struct { /* of friction: the point of the surface that the hand stuck to last */
    int64_t is_set;
    int64_t is_followed;         /* surface_m_s is known */
    touch_vector position_m;
    int64_t body;                /* that carries it; -1: none */
    touch_vector body_position_m; /* in the axes of that body */
    touch_vector surface_m_s;    /* of the surface there, low-passed */
} touch_stick_anchor;

typedef struct { /* over a seam of the medium, from the force before to the force after (touch_seam.h) */
    int64_t frame;               /* tag of the frame after the seam that was looked at last */
    int64_t is_cut;              /* the medium jumps there: the frame before stands until then */
    int64_t is_starting;         /* this tick is the first one after a seam */
    int64_t is_waiting;          /* for frames of a seek, or late ones */
    int64_t is_field_missing;    /* in the tick before: no frame, or no position */
    double late_s;               /* since the latest frame */
    double left_s;               /* of the fade; 0: there is none */
    double pressed_n;            /* |force| before, in the field: friction fades from that */
    touch_vector force_n, torque_nm; /* by which force and torque before were larger */
    double max_n, max_nm;        /* |force| and |torque| before */
    touch_vector hand_m;         /* in the tick before */
} touch_seam;

typedef struct { /* what one tick leaves for the next */
    int64_t is_started;
    double since_s;              /* the latest position */
    touch_vector device_m;       /* position, in the device's axes */
    touch_vector position_m, velocity_m_s; /* in the field */
    touch_vector field_force_n, friction_n;
    touch_vector field_torque_nm;
    double gain;                 /* of the ramp, 0 to 1 */
    touch_limited force, torque;
    double energy_j;             /* what the hand put in and did not get back */
    touch_vector past_forces_n[TOUCH_PAST_FORCES]; /* the latest first, without gravity */
    double vibration_phase;      /* rad */
    touch_proxy proxy;
    touch_stick_anchor anchor;
    touch_seam seam;
    double brake_n_s_per_m;      /* on its way to that of the settings */
    touch_vector brake_normal;   /* the direction of the field's force, low-passed; its length is at most 1 */
    double compliance_m_per_n;   /* 1 / K of the virtual coupling, on its way to that of the settings */
    double friction;             /* mu at this point: of the material, else of the settings */
    double slid_m;               /* since friction last gave way */
    touch_matrix tool_rotation;  /* field from tool */
} touch_tick_state;

enum { TOUCH_TIME_BINS = 3000 }; /* of 1 us; one more has all above */

typedef struct {
    int64_t ticks, late, missed; /* later than half a period; periods without a tick */
    int64_t underruns, stalled_ticks, waits, waiting_ticks;
    int64_t silences, silent_ticks; /* times that the player, or the thread that decodes, gave no sign of life */
    int64_t first_ns, last_ns, worst_period_ns, worst_lateness_ns;
    int64_t frames_used;
    int64_t played_ticks;        /* in which the medium was to be played */
    int64_t periods[TOUCH_TIME_BINS + 1], latenesses[TOUCH_TIME_BINS + 1];
} touch_counts;

typedef struct { /* one tick */
    double time_s, media_s;
    touch_vector position_m, velocity_m_s, field_force_n, friction_n, force_n;
    int64_t flags;               /* TOUCH_FLAG_... */
    double orientation[4];
    touch_vector field_torque_nm, torque_nm;
    int64_t buttons;
    double gripper_m;
} touch_log_row;

enum {
    TOUCH_FLAG_RUNNING = 1, TOUCH_FLAG_WAITING = 2, TOUCH_FLAG_STALLED = 4, TOUCH_FLAG_ENDED = 8, /* of the feed */
    TOUCH_FLAG_STOPPING = 16,    /* on the way to zero after a stop */
    TOUCH_FLAG_SILENT = 32,      /* no sign of life of the player, or of the thread that decodes */
    TOUCH_FLAG_PAUSED = 64
};

/* -- materials -------------------------------------------------------------------------------------------------------- */

enum {
    TOUCH_SINE_COUNT = 64,
    TOUCH_MATERIAL_CREST = 4     /* a sum of sines hardly ever reaches this multiple of its rms */
};

typedef struct { /* of all materials; the materials lie behind it */
    double frequency_rad_s[TOUCH_SINE_COUNT], phase_rad[TOUCH_SINE_COUNT];
} touch_material_sines;

typedef struct { /* speeds, forces and levels lie behind the last material */
    double friction;             /* kinetic; not a number: that of the medium */
    double static_friction;      /* just before it gives way */
    double slip_m;               /* length of a slip */
    int64_t body;                /* -1: any */
    touch_vector low_m, high_m;  /* of the box it applies in */
    int64_t speed_count, speed_offset; /* m/s, ascending */
    int64_t force_count, force_offset; /* N, ascending */
    int64_t level_offset;        /* N rms [speeds][forces][bands] */
} touch_material;

/* -- the whole -------------------------------------------------------------------------------------------------------- */

typedef struct {
    touch_receiver_layout layout;
    touch_settings settings;
    touch_orders orders;
    touch_clock clock;
    touch_grip grip;
    touch_tick_state state;
    touch_counts counts;
} touch_receiver;

#endif
