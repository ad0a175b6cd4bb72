/* touch_proxy.h: the proxy, or god object (Zilles and Salisbury 1995; cAlgorithmFingerProxy of CHAI3D): a point that stays
   on a surface while the hand, the device's point, is pressed into it. A spring pulls the hand towards it.

   There is no mesh. The surface is where the force of the field reaches a level, |F| = level_n, and its outward normal is
   the direction of the force (Salisbury and Tarr 1997). A point where |F| is larger is within.

   One tick is touch_contact_force, the last function of this file; it calls those above it:

       touch_carried_position          the proxy of the tick before, moved with the body that it touches
       touch_move_proxy                towards the hand without friction, at most eight steps of half a sample:
           touch_push_out                  out of a surface that moved over it
           touch_constrained_motion        the motion to the hand, along the constraint planes: one, two or three
           touch_find_surface              a step that ends within a surface is brought back onto it
           touch_add_constraint            its tangent plane constrains the next step
       touch_store_proxy               for the next tick
       touch_proxy_force               a spring, or the stored force where this is that of the same wall:
           touch_ramp_depth                how far the proxy lies below the surface of what was coded, x
           touch_field_share               how far the stored force is that of this wall
       touch_ease_jump                 where the proxy jumped, its force comes slowly

   The force is that of a spring, F = K (|proxy - hand| + x), along proxy - hand. The low-pass of a field makes a ramp of each
   wall, and x extrapolates that ramp. Where the stored force at the hand agrees with that spring, it is rendered itself;
   where a wall is thin or has an edge, the spring still stops the hand. Friction acts at the proxy (touch_friction.h). Steps
   get shorter where those of the tick before went to and fro, so that the proxy comes to rest. */
#ifndef TOUCH_PROXY_H
#define TOUCH_PROXY_H

#include "touch_query.h"

#define TOUCH_PROXY_STEPS 8             /* of one tick: some four samples */
#define TOUCH_PROXY_MIN_MOTION_M 1e-7   /* a shorter motion is none */
#define TOUCH_PROXY_MIN_STEP 0.003      /* of the longest step */
#define TOUCH_PROXY_TURN_BACK 0.25      /* of the motion before: one that goes back by so much has crossed an edge */
#define TOUCH_PROXY_SAME_NORMAL 0.9     /* cosine of normals that are those of one surface */
#define TOUCH_PROXY_SLIDE_LEVELS 6.0    /* a step along a surface that ends below so much is moved out along the normal */
#define TOUCH_PROXY_TOUCHING_LEVELS 0.9  /* a proxy with more than this is on a surface at the start of a tick */
#define TOUCH_PROXY_FREE_LEVELS 0.5      /* a proxy with less than this has left the surface */
#define TOUCH_PROXY_OFF_LEVELS 1.5      /* more is no point of a surface */
#define TOUCH_PROXY_TOLERANCE 0.01      /* of the level: how well the proxy lies on the surface */
#define TOUCH_PROXY_ROUNDS 4            /* of a search for the surface */
#define TOUCH_PROXY_RAMP_SAMPLES 2.0    /* behind the surface, from where on the low-pass leaves a ramp as it is */
#define TOUCH_PROXY_RAMP_DOUBT 0.05     /* samples: by so much a ramp within the low-pass overestimates */
#define TOUCH_PROXY_THIN_RATIO 0.2      /* of the stored force to that of the spring: up to this a wall is thin, */
#define TOUCH_PROXY_THIN_WIDTH 0.3      /* and from so much more on it is thick */
#define TOUCH_PROXY_EDGE_COSINE 0.85     /* between the stored force and that of the spring: up to this it is an edge, */
#define TOUCH_PROXY_EDGE_WIDTH 0.13     /* and from so much more on a surface */
#define TOUCH_PROXY_EASE_S 1.0          /* in which the correction at rest may change by a large force of the field */
#define TOUCH_PROXY_FOLLOW 3.0          /* times the motion of hand and surface: a step of the proxy that is longer is a jump */
#define TOUCH_PROXY_MIN_JUMP 0.1        /* of the longest step: a shorter one is none */
#define TOUCH_PROXY_STEEP 20.0          /* times the spring: more is no change of force by a motion of the hand */
#define TOUCH_PROXY_LEAK 0.25           /* of the spring: what a motion gives back of a jump's force */

typedef struct { /* the field at this time, and what defines its surface */
    touch_receiver *receiver;
    const touch_instant *instant;
    double stiffness_n_per_m; /* K of the spring; the field's |F| grows by about as much inwards */
    double level_n;           /* the surface is where |F| is this */
    double large_n;           /* a large force of the field */
    double max_step_m;        /* of the proxy: half a sample */
    touch_vector spacing_m;   /* of the samples */
} touch_isosurface;

typedef struct { /* a point, and the force there by size and direction */
    touch_vector position_m;
    double force_n;      /* |F|: above level_n the point is within the surface */
    touch_vector normal; /* F / |F|, outwards; zero without a force */
} touch_field_point;

typedef struct { /* the tangent planes of the surfaces that stop the proxy, by their normals, the latest first; behind `count`
                    are those of surfaces that it has left: one that it comes back to stops it again, as in a corner */
    touch_vector normal[3];
    int count;
} touch_constraint_planes;

/* Half the time of touch_norm, where no square is beyond the range of double. */
static inline double touch_magnitude(touch_vector v) { return sqrt(touch_dot(v, v)); }

/* The field at a point. */
static inline touch_field_point touch_probe(const touch_isosurface *s, touch_vector point_m) {
    touch_vector force = touch_force_at(s->instant, point_m);
    touch_field_point found;
    found.position_m = point_m;
    found.force_n = touch_magnitude(force);
    found.normal = touch_zero();
    if (found.force_n > 0.0 && found.force_n < HUGE_VAL)
        found.normal = touch_scale(1.0 / found.force_n, force);
    else
        found.force_n = 0.0;
    return found;
}

/* -- points on the surface -------------------------------------------------------------------------------------------- */

/* A point at a surface, moved onto it along the normal by the secant method. */
static inline touch_field_point touch_move_onto_surface(const touch_isosurface *s, touch_field_point at) {
    double slope = s->stiffness_n_per_m;
    for (int n = 0; n < TOUCH_PROXY_ROUNDS; n++) {
        if (fabs(at.force_n - s->level_n) <= TOUCH_PROXY_TOLERANCE * s->level_n) break;
        double motion = touch_clamp((at.force_n - s->level_n) / slope, -s->max_step_m, s->max_step_m);
        touch_field_point next = touch_probe(s, touch_add_scaled(at.position_m, motion, at.normal));
        if (next.force_n == 0.0) { /* outside of the field: a shorter motion */
            slope *= 4.0;
            continue;
        }
        slope = (at.force_n - next.force_n) / motion;
        slope = touch_clamp(slope, 0.05 * s->stiffness_n_per_m, 4.0 * s->stiffness_n_per_m);
        at = next;
    }
    return at;
}

/* Where the line from a point outside to one within enters the surface: false position, with the value at an end that stays
   halved (the Illinois rule). */
static inline touch_field_point touch_find_crossing(const touch_isosurface *s, touch_field_point outside,
                                                    touch_field_point inside) {
    double low = 0.0, high = 1.0, low_n = outside.force_n - s->level_n, high_n = inside.force_n - s->level_n;
    touch_vector motion = touch_subtract(inside.position_m, outside.position_m);
    touch_field_point found = inside;
    int moved = 0; /* the end that moved last: 1 is the inner one, -1 the outer one */
    for (int n = 0; n < 2 * TOUCH_PROXY_ROUNDS; n++) {
        double fraction = (low * high_n - high * low_n) / (high_n - low_n);
        found = touch_probe(s, touch_add_scaled(outside.position_m, fraction, motion));
        double off = found.force_n - s->level_n;
        if (fabs(off) <= TOUCH_PROXY_TOLERANCE * s->level_n) break;
        if (off > 0.0) {
            high = fraction;
            high_n = off;
            if (moved == 1) low_n *= 0.5;
            moved = 1;
        } else {
            low = fraction;
            low_n = off;
            if (moved == -1) high_n *= 0.5;
            moved = -1;
        }
    }
    return found;
}

/* Spacing of the samples along a direction, metres. */
static inline double touch_sample_length(const touch_isosurface *s, touch_vector normal) {
    touch_vector d = s->spacing_m;
    return touch_magnitude(touch_vector_of(d.x * normal.x, d.y * normal.y, d.z * normal.z));
}

/* The normal at the surface: that of the force some samples behind it, which is steadier; its own where the wall is thin. */
static inline touch_vector touch_steady_normal(const touch_isosurface *s, touch_field_point at) {
    double depth = TOUCH_PROXY_RAMP_SAMPLES * touch_sample_length(s, at.normal);
    touch_vector behind = touch_probe(s, touch_add_scaled(at.position_m, -depth, at.normal)).normal;
    return touch_dot(behind, at.normal) > TOUCH_PROXY_SAME_NORMAL ? behind : at.normal;
}

/* -- constraint planes ------------------------------------------------------------------------------------------------ */

/* True if a motion goes into none of the planes. */
static inline int touch_is_free_motion(touch_vector motion, const touch_constraint_planes *planes) {
    for (int n = 0; n < planes->count; n++)
        if (touch_dot(motion, planes->normal[n]) < -1e-9 * touch_magnitude(motion)) return 0;
    return 1;
}

/* A motion as far as up to three planes let it: the nearest one that goes into none of them. It is the motion itself, or its
   projection onto one plane, or else onto the line where two of them meet; zero in a corner of three. */
static inline touch_vector touch_constrained_motion(touch_vector motion, const touch_constraint_planes *planes) {
    touch_vector best = touch_zero();
    double longest = 0.0;
    if (touch_is_free_motion(motion, planes)) return motion;
    for (int n = 0; n < planes->count; n++) {
        touch_vector along = touch_add_scaled(motion, -touch_dot(motion, planes->normal[n]), planes->normal[n]);
        if (touch_magnitude(along) > longest && touch_is_free_motion(along, planes)) {
            best = along;
            longest = touch_magnitude(along);
        }
    }
    if (longest > 0.0) return best;
    for (int n = 0; n < planes->count; n++) {
        for (int m = 0; m < n; m++) {
            touch_vector line = touch_cross(planes->normal[n], planes->normal[m]);
            double square = touch_dot(line, line);
            touch_vector along = touch_scale(square > 1e-12 ? touch_dot(motion, line) / square : 0.0, line);
            if (touch_magnitude(along) > longest && touch_is_free_motion(along, planes)) {
                best = along;
                longest = touch_magnitude(along);
            }
        }
    }
    return best;
}

/* Add the surface that the proxy has just met. It replaces one of about the same normal. A proxy on one surface leaves it
   for the next, as over an edge; only once it comes back to the one before do both stop it, as in a corner. */
static inline void touch_add_constraint(touch_constraint_planes *planes, touch_vector normal) {
    touch_vector *known = planes->normal;
    if (touch_dot(known[0], normal) > TOUCH_PROXY_SAME_NORMAL) {
        known[0] = normal;
        if (planes->count < 1) planes->count = 1;
    } else if (planes->count <= 1) {
        planes->count = touch_dot(known[1], normal) > TOUCH_PROXY_SAME_NORMAL ? 2 : 1;
        known[1] = known[0];
        known[0] = normal;
    } else if (touch_dot(known[1], normal) > TOUCH_PROXY_SAME_NORMAL) {
        known[1] = normal;
    } else {
        known[2] = normal;
        planes->count = 3;
    }
}

/* -- the search of a tick --------------------------------------------------------------------------------------------- */

/* Move a proxy out of a surface that came over it, some steps, and onto the surface. */
static inline touch_field_point touch_push_out(const touch_isosurface *s, touch_field_point at) {
    for (int n = 0; n < TOUCH_PROXY_STEPS && at.force_n > TOUCH_PROXY_SLIDE_LEVELS * s->level_n; n++) {
        double motion = touch_fmin((at.force_n - s->level_n) / s->stiffness_n_per_m, s->max_step_m);
        at = touch_probe(s, touch_add_scaled(at.position_m, motion, at.normal));
    }
    return at.force_n > s->level_n ? touch_move_onto_surface(s, at) : at;
}

/* Adapt the length of the steps: shorter where the motion turns back over an edge, so that the proxy comes to rest between,
   and longer again where it goes on. */
static inline void touch_adapt_step(const touch_isosurface *s, touch_vector motion, touch_vector before, double *step_m,
                                    double *growth) {
    double cosine = touch_dot(motion, before);
    if (cosine < -TOUCH_PROXY_TURN_BACK * touch_dot(before, before))
        *step_m = 0.4 * *step_m, *growth = 1.0;
    else if (cosine > TOUCH_PROXY_SAME_NORMAL * touch_magnitude(motion) * touch_magnitude(before))
        *step_m = touch_fmin(*growth * *step_m, s->max_step_m);
}

/* Bring the end of a step onto the surface. A force along the motion is that of the far side of a thin wall: back to where the
   step went in. 0: it cannot be found, as where forces turn within a sample. */
static inline int touch_find_surface(const touch_isosurface *s, touch_field_point at, touch_vector motion, int is_sliding,
                                     touch_vector hand_m, touch_field_point *next) {
    double max_approach = is_sliding ? 0.5 * touch_magnitude(motion) : 0.0;
    if (next->force_n <= TOUCH_PROXY_SLIDE_LEVELS * s->level_n && touch_dot(next->normal, motion) <= max_approach) {
        *next = touch_move_onto_surface(s, *next);
    } else if (next->force_n > s->level_n) {
        if (at.force_n > s->level_n) return 0; /* from within, no crossing can be found */
        *next = touch_find_crossing(s, at, *next);
    }
    double farther = touch_magnitude(touch_subtract(hand_m, next->position_m));
    farther -= touch_magnitude(touch_subtract(hand_m, at.position_m));
    return !(next->force_n > TOUCH_PROXY_OFF_LEVELS * s->level_n || farther > s->max_step_m);
}

/* Move the proxy from `*position_m` towards the hand, without friction. 1: a surface stops it; 0: the hand is free. */
static inline int touch_move_proxy(const touch_isosurface *s, touch_vector hand_m, touch_vector *position_m) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_constraint_planes planes = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}, 0};
    touch_field_point at = touch_push_out(s, touch_probe(s, *position_m));
    if (at.force_n > TOUCH_PROXY_TOUCHING_LEVELS * s->level_n) touch_add_constraint(&planes, touch_steady_normal(s, at));
    touch_vector before = touch_zero();
    int left_planes = 0; /* how many planes the proxy left; they hold on where no step is left to find out */
    double growth = 2.0, step_m = s->max_step_m, min_step_m = TOUCH_PROXY_MIN_STEP * s->max_step_m;
    if (proxy->is_in_contact) step_m = touch_fmax(proxy->step_m, 2.0 * min_step_m);
    for (int n = 0; n < TOUCH_PROXY_STEPS; n++) {
        touch_vector motion = touch_constrained_motion(touch_subtract(hand_m, at.position_m), &planes);
        double length = touch_magnitude(motion);
        touch_adapt_step(s, motion, before, &step_m, &growth);
        if (length <= TOUCH_PROXY_MIN_MOTION_M || step_m < min_step_m) break;
        before = motion;
        touch_field_point next = touch_probe(s, touch_add_scaled(at.position_m, touch_fmin(length, step_m) / length, motion));
        int is_free = next.force_n < TOUCH_PROXY_FREE_LEVELS * s->level_n;
        int is_leaving = touch_dot(touch_subtract(hand_m, next.position_m), next.normal) >= 0.0;
        if (next.force_n <= s->level_n && (is_free || is_leaving)) { /* no surface stops this step, or one pushes it on */
            if (!planes.count && length <= step_m) {                 /* it ends at the hand */
                *position_m = next.position_m;
                return 0;
            }
            if (planes.count > left_planes) left_planes = planes.count;
            at = next;
            planes.count = 0;
            continue;
        }
        if (!touch_find_surface(s, at, motion, planes.count > 0, hand_m, &next)) {
            /* a force that begins with a jump has no point at the level: the proxy stays in front of it */
            int is_jump = !planes.count && at.force_n <= s->level_n && next.force_n > s->level_n;
            if (is_jump) touch_add_constraint(&planes, next.normal);
            break;
        }
        at = next;
        touch_add_constraint(&planes, touch_steady_normal(s, at));
    }
    int count = planes.count > 0 ? planes.count : left_planes;
    proxy->step_m = step_m;
    *position_m = at.position_m;
    return count > 0 && touch_dot(touch_subtract(hand_m, at.position_m), planes.normal[count - 1]) < 0.0;
}

/* -- bodies that move ------------------------------------------------------------------------------------------------- */

/* Where the proxy of the tick before lies now, if the body that it touches has moved. */
static inline touch_vector touch_carried_position(const touch_isosurface *s) {
    const touch_proxy *proxy = &s->receiver->state.proxy;
    if (proxy->body < 0 || proxy->body >= touch_body_count(s->instant)) return proxy->position_m;
    touch_matrix rotation = touch_body_rotation(s->instant, proxy->body);
    return touch_add(touch_rotate(&rotation, proxy->body_position_m), touch_body_position(s->instant, proxy->body));
}

/* Store the position of the proxy, also in the axes of the body that pushes most there. */
static inline void touch_store_proxy(const touch_isosurface *s, touch_vector position_m, int is_in_contact) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    const touch_body_pose *poses = (const touch_body_pose *)(s->instant->before + 1);
    proxy->is_active = 1;
    proxy->is_in_contact = is_in_contact;
    proxy->body = -1;
    proxy->position_m = position_m;
    if (!is_in_contact || poses->is_identity) return; /* voxels carry nothing */
    int64_t body = touch_strongest_body(s->instant, position_m);
    if (body < 0) return;
    touch_matrix rotation = touch_body_rotation(s->instant, body);
    touch_vector arm = touch_subtract(position_m, touch_body_position(s->instant, body));
    proxy->body = body;
    proxy->body_position_m = touch_rotate_back(&rotation, arm);
}

/* -- the force -------------------------------------------------------------------------------------------------------- */

/* Depth of a proxy below the surface that the ramp of forces behind it extrapolates to, metres; negative above. Two samples
   behind the surface the low-pass of the field is over. Where the force has its maximum before that, or the wall ends, the
   force half as far behind is taken, with a margin. At most half the depth of the hand, so that x grows from zero. */
static inline double touch_ramp_depth(const touch_isosurface *s, touch_vector position_m, touch_vector inwards,
                                      double depth_m) {
    double sample = touch_sample_length(s, inwards), k = s->stiffness_n_per_m;
    double deep_n = touch_probe(s, touch_add_scaled(position_m, TOUCH_PROXY_RAMP_SAMPLES * sample, inwards)).force_n;
    double shallow_n = touch_probe(s, touch_add_scaled(position_m, sample, inwards)).force_n;
    double depth = deep_n / k - TOUCH_PROXY_RAMP_SAMPLES * sample;
    depth = touch_fmax(depth, shallow_n / k - (1.0 + TOUCH_PROXY_RAMP_DOUBT) * sample);
    depth = touch_fmax(depth, -sample);
    return touch_fmin(touch_fmin(depth, sample), 0.5 * depth_m);
}

/* How far the field itself is the force of this wall, 0 to 1. In a wall that fills its neighbourhood the stored force at the
   hand is what the proxy's spring approximates, but it changes with time as smoothly as the field does, and not as a surface
   that is searched for; so it is rendered. Where the wall is thin or has an edge the stored force is smaller or turned. */
static inline double touch_field_share(const touch_isosurface *s, touch_vector stored_n, touch_vector outwards,
                                       double force_n) {
    double stored = touch_magnitude(stored_n), expected = touch_fmin(force_n, s->large_n);
    if (!(stored > 0.0)) return 0.0;
    double along = touch_dot(stored_n, outwards), by_size = 1.0;
    if (expected > 0.0)
        by_size = touch_smooth_step((along / expected - TOUCH_PROXY_THIN_RATIO) / TOUCH_PROXY_THIN_WIDTH);
    return by_size * touch_smooth_step((along / stored - TOUCH_PROXY_EDGE_COSINE) / TOUCH_PROXY_EDGE_WIDTH);
}

typedef struct {           /* in a tick, beside the body that carries the proxy */
    double hand_m;         /* how far the hand moved */
    double surface_n;      /* by how much |F| changed at the proxy */
    double total_m;        /* how far hand and surface moved */
} touch_contact_motion;

static inline touch_contact_motion touch_motion_of(const touch_isosurface *s, touch_vector hand_m, touch_vector carried_m) {
    const touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector carried = touch_subtract(carried_m, proxy->position_m);
    touch_contact_motion motion;
    motion.hand_m = touch_magnitude(touch_subtract(touch_subtract(hand_m, proxy->hand_m), carried));
    motion.surface_n = fabs(touch_probe(s, carried_m).force_n - proxy->surface_n);
    motion.total_m = motion.hand_m + motion.surface_n / s->stiffness_n_per_m;
    return motion;
}

/* A vector, shortened by a length. */
static inline touch_vector touch_shortened(touch_vector v, double length) {
    double size = touch_magnitude(v);
    return size > length ? touch_scale(1.0 - length / size, v) : touch_zero();
}

/* Whether the proxy moved by more than hand and surface explain, to another surface, or on or off one; or the force changed by
   more than the field's own and a motion of the hand, where the medium changes. */
static inline int touch_has_jumped(const touch_isosurface *s, const touch_contact_motion *motion, double step_m,
                                   double field_n, double jump_n) {
    if (step_m > TOUCH_PROXY_FOLLOW * motion->total_m + TOUCH_PROXY_MIN_JUMP * s->max_step_m) return 1;
    if (s->instant->before == s->instant->after) return 0; /* the medium stands still */
    return jump_n > field_n + TOUCH_PROXY_STEEP * s->stiffness_n_per_m * motion->hand_m;
}

/* Where the proxy jumped, the hand gets the field's own change; the rest is given back with time and with motion. */
static inline void touch_ease_jump(const touch_isosurface *s, const touch_contact_motion *motion, double step_m,
                                   touch_vector force_n, touch_vector stored_n, double dt_s) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector field_n = touch_subtract(stored_n, proxy->stored_n);
    touch_vector jump_n = touch_subtract(touch_subtract(force_n, proxy->force_n), field_n);
    if (touch_has_jumped(s, motion, step_m, touch_magnitude(field_n), touch_magnitude(jump_n)))
        proxy->eased_n = touch_add(proxy->eased_n, jump_n);
    double given_n = TOUCH_PROXY_LEAK * s->stiffness_n_per_m * motion->total_m + s->large_n * dt_s / TOUCH_PROXY_EASE_S;
    proxy->eased_n = touch_shortened(proxy->eased_n, given_n);
}

/* The force of the proxy on the hand, N: that of its spring, or the stored one where this is that of the same wall. */
static inline touch_vector touch_proxy_force(const touch_isosurface *s, touch_vector hand_m, touch_vector stored_n) {
    const touch_tick_state *state = &s->receiver->state;
    touch_vector pull = touch_subtract(state->proxy.position_m, hand_m);
    /* where the loop needs a softer spring, the stored force would be too stiff */
    double k = 1.0 / (1.0 / s->stiffness_n_per_m + state->compliance_m_per_n);
    double depth = touch_magnitude(pull);
    touch_vector outwards = touch_scale(1.0 / depth, pull);
    double ramp_depth = touch_ramp_depth(s, state->proxy.position_m, touch_scale(-1.0, outwards), depth);
    double force = touch_fmax(touch_fmax(0.0, touch_dot(stored_n, outwards)), k * (depth + ramp_depth));
    double share = state->compliance_m_per_n > 0.0 ? 0.0 : touch_field_share(s, stored_n, outwards, force);
    return touch_add(touch_scale(share, stored_n), touch_scale((1.0 - share) * force, outwards));
}

/* The force on the hand, N, without friction. One tick of the proxy. Friction acts at the proxy, state.proxy.position_m. */
static inline touch_vector touch_contact_force(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m,
                                               double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_proxy *proxy = &receiver->state.proxy;
    touch_isosurface s = {receiver, t, settings->wall_n_per_m, settings->wall_level_n, settings->wall_force_n, 0.0,
                          settings->wall_spacing_m};
    s.max_step_m = 0.5 * touch_fmin(touch_fmin(s.spacing_m.x, s.spacing_m.y), s.spacing_m.z);
    int is_new = !proxy->is_active;
    touch_vector carried = is_new ? hand_m : touch_carried_position(&s), position = carried;
    touch_contact_motion motion = touch_motion_of(&s, hand_m, carried);
    int is_in_contact = touch_move_proxy(&s, hand_m, &position);
    touch_store_proxy(&s, position, is_in_contact);
    touch_vector stored = touch_force_at(t, hand_m);
    touch_vector force = is_in_contact ? touch_proxy_force(&s, hand_m, stored) : stored;
    if (is_new)
        proxy->eased_n = touch_zero();
    else
        touch_ease_jump(&s, &motion, touch_magnitude(touch_subtract(position, carried)), force, stored, dt_s);
    proxy->surface_n = touch_probe(&s, position).force_n;
    proxy->hand_m = hand_m;
    proxy->force_n = force;
    proxy->stored_n = stored;
    return touch_subtract(force, proxy->eased_n);
}

#endif
