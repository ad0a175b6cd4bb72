/* touch_proxy_search.h: how the proxy of touch_proxy.h gets to its place on the surface: the point nearest to the hand that it
   comes to without a way through the surface. One tick is touch_move_proxy, the last function of this file:

       touch_move_proxy                towards the hand without friction, at most eight steps of half a sample:
           touch_push_out                  out of a surface that moved over it
           touch_constrained_motion        the motion to the hand, along the constraint planes: one, two or three
           touch_find_surface              a step that ends within a surface is brought back onto it
           touch_add_constraint            its tangent plane constrains the next step
       where it stops:
           touch_is_lost                   a proxy that hangs at a rim starts anew at the hand,
           touch_is_way_free               and one behind a shell, if the hand is in free space in front;
           released_s                      and any that has held no hand for 20 ms and does not follow it

   Steps get shorter where those of the tick before went to and fro. The proxy goes from the hand only about as far as hand and
   surface moved, so that it comes to rest where they do. */
#ifndef TOUCH_PROXY_SEARCH_H
#define TOUCH_PROXY_SEARCH_H

#include "touch_query.h"

#define TOUCH_PROXY_STEPS 8                   /* of one tick: some four samples */
#define TOUCH_PROXY_MIN_MOTION_M 1e-7         /* a shorter motion is none */
#define TOUCH_PROXY_MIN_APPROACH_M 1e-8       /* a proxy that gets no nearer to a hand at rest stays where it is */
#define TOUCH_PROXY_MIN_STEP 0.003            /* of the longest step */
#define TOUCH_PROXY_SHORTER 0.4               /* times the step: the next one after a step that led nowhere */
#define TOUCH_PROXY_TURN_BACK 0.25            /* of the motion before: one that goes back by so much has crossed an edge */
#define TOUCH_PROXY_SAME_NORMAL 0.9           /* cosine of normals that are those of one surface */
#define TOUCH_PROXY_SLIDE_LEVELS 6.0          /* a step along a surface that ends below so much is moved out along the normal */
#define TOUCH_PROXY_TOUCHING_LEVELS 0.9       /* a proxy with more than this is on a surface at the start of a tick */
#define TOUCH_PROXY_FREE_LEVELS 0.5           /* a proxy with less than this has left the surface */
#define TOUCH_PROXY_OFF_LEVELS 1.5            /* more is no point of a surface */
#define TOUCH_PROXY_TOLERANCE 0.01            /* of the level: how well the proxy lies on the surface */
#define TOUCH_PROXY_ROUNDS 4                  /* of a search for the surface */
#define TOUCH_PROXY_PULL_COSINE 0.2           /* between pull and normal: a surface that is pulled along stops no hand */
#define TOUCH_PROXY_LOST_STEPS 16             /* half samples that a proxy which hangs may stay behind its hand, */
#define TOUCH_PROXY_LOST_FORCES 2.0           /* and one which does not so many depths of a large force more */
#define TOUCH_PROXY_LOST_COSINE 0.5           /* between the forces at hand and proxy: from here on they push to one side */
#define TOUCH_PROXY_RELEASED_S 0.0205         /* where it holds no hand so long, it starts anew at the hand; no multiple of a tick */
#define TOUCH_PROXY_WAY_LEAST_STEPS 8         /* half samples: a proxy nearer to a free hand is at its surface, */
#define TOUCH_PROXY_WAY_STEPS 1024            /* half samples: a proxy farther from a free hand looks for no straight way to it */
#define TOUCH_PROXY_RAMP_SAMPLES 2.0          /* behind the surface, from where on the low-pass leaves a ramp as it is */

typedef struct { /* the field at this time, and what defines its surface */
    touch_receiver *receiver;
    const touch_instant *instant;
    double stiffness_n_per_m; /* K of the spring; the field's |F| grows by about as much inwards */
    double level_n;           /* the surface is where |F| is this */
    double large_n;           /* a large force of the field */
    double max_step_m;        /* of the proxy: half a sample */
    touch_vector spacing_m;   /* of the samples */
} touch_isosurface;

static inline touch_isosurface touch_isosurface_of(touch_receiver *receiver, const touch_instant *t) {
    const touch_settings *settings = &receiver->settings;
    touch_isosurface s = {receiver, t, settings->wall_n_per_m, settings->wall_level_n, settings->wall_force_n, 0.0,
                          settings->wall_spacing_m};
    s.max_step_m = 0.5 * touch_fmin(touch_fmin(s.spacing_m.x, s.spacing_m.y), s.spacing_m.z);
    return s;
}

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

static inline double touch_distance(touch_vector p, touch_vector q) { return touch_magnitude(touch_subtract(p, q)); }

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
        /* outside of the field, or farther off the level on the same side, as where forces turn: a shorter motion */
        if (next.force_n == 0.0 || (next.force_n - s->level_n) / (at.force_n - s->level_n) > 1.0) {
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
        *step_m = TOUCH_PROXY_SHORTER * *step_m, *growth = 1.0;
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
    double farther = touch_distance(hand_m, next->position_m) - touch_distance(hand_m, at.position_m);
    return !(next->force_n > TOUCH_PROXY_OFF_LEVELS * s->level_n || farther > s->max_step_m);
}

/* The largest cosine between the normals of the planes and the way from the hand to its proxy. A proxy that follows its hand
   has one near 1, on an edge that of half its angle; one that hangs at a rim is pulled along its surface instead. */
static inline double touch_pull_cosine(touch_vector proxy_m, touch_vector hand_m, const touch_constraint_planes *planes,
                                       int count) {
    touch_vector pull = touch_subtract(proxy_m, hand_m);
    double length_m = touch_magnitude(pull), largest = 0.0;
    for (int n = 0; n < count && length_m > 0.0; n++)
        largest = touch_fmax(largest, touch_dot(pull, planes->normal[n]) / length_m);
    return largest;
}

/* True if a proxy cannot follow its hand along the surface, as at the rim of a shell, although the field at the hand pushes it
   out on the proxy's side: one that starts anew at the hand comes out there. `pull_cosine` is that of touch_pull_cosine; the
   proxy `hangs` where the search finds no surface to go on. */
static inline int touch_is_lost(const touch_isosurface *s, touch_field_point at, touch_vector hand_m, double pull_cosine,
                                int hangs) {
    double along = sqrt(touch_fmax(0.0, 1.0 - pull_cosine * pull_cosine)); /* of the pull, along the surface */
    double far_m = TOUCH_PROXY_LOST_STEPS * s->max_step_m;
    if (!hangs) far_m += TOUCH_PROXY_LOST_FORCES * s->large_n / s->stiffness_n_per_m;
    if (!(touch_distance(at.position_m, hand_m) * along > far_m)) return 0;
    touch_field_point hand = touch_probe(s, hand_m);
    return hand.force_n > s->level_n && touch_dot(hand.normal, at.normal) > TOUCH_PROXY_LOST_COSINE;
}

/* True if the hand is in free space and no surface on the straight way to it pushes back. A surface of a shell (a terrain, a
   depth picture) has a front only: from behind its force points along the way, and nothing holds a hand that left by the
   front. The search itself stops there, as one step of it cannot tell a back from the far side of a thin wall. */
static inline int touch_is_way_free(const touch_isosurface *s, touch_field_point at, touch_vector hand_m) {
    touch_vector way = touch_subtract(hand_m, at.position_m);
    double length_m = touch_magnitude(way), free_n = TOUCH_PROXY_FREE_LEVELS * s->level_n;
    if (length_m > TOUCH_PROXY_WAY_STEPS * s->max_step_m) return 0;
    int steps = (int)ceil(length_m / s->max_step_m);
    if (steps < TOUCH_PROXY_WAY_LEAST_STEPS || touch_dot(at.normal, way) < 0.0) return 0; /* as in most contacts */
    if (touch_probe(s, hand_m).force_n >= free_n) return 0;
    for (int n = 1; n < steps; n++) {
        touch_field_point between = touch_probe(s, touch_add_scaled(at.position_m, (double)n / steps, way));
        if (between.force_n >= free_n && touch_dot(between.normal, way) < 0.0) return 0;
    }
    return 1;
}

/* Move the proxy from where it is, `*proxy_at`, towards the hand, without friction; it may end by `away_m` farther from it.
   1: a surface stops it; 0: the hand is free. */
static inline int touch_move_proxy(const touch_isosurface *s, touch_vector hand_m, double away_m, touch_field_point *proxy_at) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_constraint_planes planes = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}, 0};
    touch_field_point at = touch_push_out(s, *proxy_at);
    if (at.force_n > TOUCH_PROXY_TOUCHING_LEVELS * s->level_n) touch_add_constraint(&planes, touch_steady_normal(s, at));
    touch_vector before = touch_zero();
    int hangs = 0;
    int left_planes = 0; /* how many planes the proxy left; they hold on where no step is left to find out */
    touch_field_point accepted = at; /* where it was last no farther from the hand than it may be */
    double farthest_m = touch_distance(hand_m, at.position_m) + away_m - TOUCH_PROXY_MIN_APPROACH_M;
    double growth = 2.0, step_m = s->max_step_m, min_step_m = TOUCH_PROXY_MIN_STEP * s->max_step_m;
    if (proxy->is_in_contact) step_m = touch_fmax(proxy->step_m, 2.0 * min_step_m);
    for (int n = 0; n < TOUCH_PROXY_STEPS; n++) {
        if (touch_distance(hand_m, at.position_m) <= farthest_m) accepted = at;
        touch_vector motion = touch_constrained_motion(touch_subtract(hand_m, at.position_m), &planes);
        double length = touch_magnitude(motion);
        touch_adapt_step(s, motion, before, &step_m, &growth);
        if (length <= TOUCH_PROXY_MIN_MOTION_M || step_m < min_step_m) break;
        before = motion;
        touch_field_point next = touch_probe(s, touch_add_scaled(at.position_m, touch_fmin(length, step_m) / length, motion));
        int is_free = next.force_n < TOUCH_PROXY_FREE_LEVELS * s->level_n;
        int is_leaving = touch_dot(touch_subtract(hand_m, next.position_m), next.normal) >= 0.0;
        /* outside, and clear of the surface or with the hand on its outer side */
        if (next.force_n <= s->level_n && (is_free || is_leaving)) {
            if (!planes.count && length <= step_m) { /* it ends at the hand */
                *proxy_at = next;
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
            hangs = 1;
            break;
        }
        at = next;
        touch_add_constraint(&planes, touch_steady_normal(s, at));
    }
    int count = planes.count > 0 ? planes.count : left_planes;
    if (touch_distance(hand_m, at.position_m) > farthest_m) {
        at = accepted;
        step_m *= TOUCH_PROXY_SHORTER;
    }
    double pull_cosine = touch_pull_cosine(at.position_m, hand_m, &planes, count);
    int is_lost = proxy->released_s > TOUCH_PROXY_RELEASED_S;
    if (count > 0) is_lost = is_lost || touch_is_lost(s, at, hand_m, pull_cosine, hangs) || touch_is_way_free(s, at, hand_m);
    if (is_lost) {
        proxy->released_s = 0.0;
        *proxy_at = touch_push_out(s, touch_probe(s, hand_m)); /* it starts anew */
        return 0;
    }
    proxy->step_m = step_m;
    *proxy_at = at;
    return count > 0 && touch_dot(touch_subtract(hand_m, at.position_m), planes.normal[count - 1]) < 0.0 &&
           pull_cosine > TOUCH_PROXY_PULL_COSINE;
}

#endif
