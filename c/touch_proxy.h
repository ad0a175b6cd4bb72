/* touch_proxy.h: the proxy, a point that stays on the surface while the hand is pressed into it. A spring pulls the hand
   towards it (the god object of Zilles and Salisbury).

   The surface lies where the force of the field reaches a level, and its normal is the direction of the force (Salisbury and
   Tarr 1997). In a tick the proxy goes towards the hand in steps of half a sample, or less where those of the tick before
   went to and fro, so that it comes to rest. Where a step ends within a surface, the point where it went in is sought, and
   the proxy slides on across the normal, in a corner across two or three. The hand is pulled to it by a spring,
   F = K (proxy - hand + x), with x the depth of the proxy below the surface that the ramp of forces behind it extrapolates
   to: what is thick is rendered as the field has it, what is thin still stops the hand.

   Friction lets the proxy stay as long as its spring pulls along the surface by less than mu times the pressure (Harwin and
   Melder 2002). A body that moves carries it, in the body's axes; a surface that moves over it pushes it out, some steps a
   tick. */
#ifndef TOUCH_PROXY_H
#define TOUCH_PROXY_H

#include "touch_query.h"

#define TOUCH_PROXY_STEPS 8             /* of one tick: some four samples */
#define TOUCH_PROXY_NO_WAY_M 1e-7       /* a shorter way is none */
#define TOUCH_PROXY_MIN_STEP 0.003      /* of the longest step */
#define TOUCH_PROXY_TURN_BACK 0.25      /* of the way before: a way that goes back by so much has crossed an edge */
#define TOUCH_PROXY_SAME_NORMAL 0.9     /* cosine of normals that are those of one surface */
#define TOUCH_PROXY_SLIDE_LEVELS 6.0    /* a step along a surface that ends below so much is moved out along the normal */
#define TOUCH_PROXY_OFF_LEVELS 1.5      /* more is no point of a surface */
#define TOUCH_PROXY_TOLERANCE 0.01      /* of the level: how well the proxy lies on the surface */
#define TOUCH_PROXY_ROUNDS 4            /* of a search for the surface */
#define TOUCH_PROXY_RAMP_SAMPLES 2.0    /* behind the surface, from where on the low-pass leaves a ramp as it is */
#define TOUCH_PROXY_RAMP_DOUBT 0.05     /* samples: by so much a ramp within the low-pass overestimates */

typedef struct { /* the field at this time and its surfaces */
    touch_receiver *receiver;
    const touch_instant *instant;
    double stiffness_n_per_m, level_n;
    double max_step_m;
    touch_vector spacing_m;
} touch_wall;

typedef struct { /* a point of the field: size and direction of the force there */
    touch_vector position_m;
    double force_n;
    touch_vector normal; /* zero without a force */
} touch_contact;

typedef struct { /* the surfaces that stop the proxy: up to three normals, the latest first */
    touch_vector normal[3];
    int count;
} touch_planes;

/* Half the time of touch_norm, where no square is beyond the range of double. */
static inline double touch_magnitude(touch_vector v) { return sqrt(touch_dot(v, v)); }

static inline touch_contact touch_probe(const touch_wall *s, touch_vector point_m) {
    touch_vector force = touch_force_at(s->instant, point_m);
    touch_contact found;
    found.position_m = point_m, found.force_n = touch_magnitude(force), found.normal = touch_zero();
    if (found.force_n > 0.0 && found.force_n < HUGE_VAL)
        found.normal = touch_scale(1.0 / found.force_n, force);
    else
        found.force_n = 0.0;
    return found;
}

/* -- points on the surface -------------------------------------------------------------------------------------------- */

/* A point at a surface, moved onto it along the normal by the secant method. */
static inline touch_contact touch_move_onto_surface(const touch_wall *s, touch_contact at) {
    double slope = s->stiffness_n_per_m;
    for (int n = 0; n < TOUCH_PROXY_ROUNDS; n++) {
        if (fabs(at.force_n - s->level_n) <= TOUCH_PROXY_TOLERANCE * s->level_n) break;
        double way = touch_clamp((at.force_n - s->level_n) / slope, -s->max_step_m, s->max_step_m);
        touch_contact next = touch_probe(s, touch_add_scaled(at.position_m, way, at.normal));
        if (next.force_n == 0.0) { /* outside of the field: a shorter way */
            slope *= 4.0;
            continue;
        }
        slope = (at.force_n - next.force_n) / way;
        slope = touch_clamp(slope, 0.05 * s->stiffness_n_per_m, 4.0 * s->stiffness_n_per_m);
        at = next;
    }
    return at;
}

/* Where the way from a point outside to one within enters the surface: false position, with the value at an end that stays
   halved (the Illinois rule). */
static inline touch_contact touch_find_crossing(const touch_wall *s, touch_contact outside, touch_contact inside) {
    double low = 0.0, high = 1.0, low_n = outside.force_n - s->level_n, high_n = inside.force_n - s->level_n;
    touch_vector way = touch_subtract(inside.position_m, outside.position_m);
    touch_contact found = inside;
    int moved = 0; /* the end that moved last: 1 is the inner one, -1 the outer one */
    for (int n = 0; n < 2 * TOUCH_PROXY_ROUNDS; n++) {
        double fraction = (low * high_n - high * low_n) / (high_n - low_n);
        found = touch_probe(s, touch_add_scaled(outside.position_m, fraction, way));
        double off = found.force_n - s->level_n;
        if (fabs(off) <= TOUCH_PROXY_TOLERANCE * s->level_n) break;
        if (off > 0.0) {
            high = fraction, high_n = off;
            if (moved == 1) low_n *= 0.5;
            moved = 1;
        } else {
            low = fraction, low_n = off;
            if (moved == -1) high_n *= 0.5;
            moved = -1;
        }
    }
    return found;
}

/* Spacing of the samples along a direction, metres. */
static inline double touch_sample_length(const touch_wall *s, touch_vector normal) {
    touch_vector d = s->spacing_m;
    return touch_magnitude(touch_vector_of(d.x * normal.x, d.y * normal.y, d.z * normal.z));
}

/* The normal at the surface: that of the force some samples behind it, which is steadier; its own where the wall is thin. */
static inline touch_vector touch_steady_normal(const touch_wall *s, touch_contact at) {
    double depth = TOUCH_PROXY_RAMP_SAMPLES * touch_sample_length(s, at.normal);
    touch_vector behind = touch_probe(s, touch_add_scaled(at.position_m, -depth, at.normal)).normal;
    return touch_dot(behind, at.normal) > TOUCH_PROXY_SAME_NORMAL ? behind : at.normal;
}

/* -- ways along surfaces ---------------------------------------------------------------------------------------------- */

/* True if a way goes into none of the planes. */
static inline int touch_is_free_way(touch_vector way, const touch_planes *planes) {
    for (int n = 0; n < planes->count; n++)
        if (touch_dot(way, planes->normal[n]) < -1e-9 * touch_magnitude(way)) return 0;
    return 1;
}

/* What is left of a way in front of up to three planes: the nearest way that goes into none, first along a plane, else along
   the line where two of them meet; zero in a corner. */
static inline touch_vector touch_allowed_way(touch_vector way, const touch_planes *planes) {
    touch_vector best = touch_zero();
    double longest = 0.0;
    if (touch_is_free_way(way, planes)) return way;
    for (int n = 0; n < planes->count; n++) {
        touch_vector along = touch_add_scaled(way, -touch_dot(way, planes->normal[n]), planes->normal[n]);
        if (touch_magnitude(along) > longest && touch_is_free_way(along, planes))
            best = along, longest = touch_magnitude(along);
    }
    if (longest > 0.0) return best;
    for (int n = 0; n < planes->count; n++) {
        for (int m = 0; m < n; m++) {
            touch_vector line = touch_cross(planes->normal[n], planes->normal[m]);
            double square = touch_dot(line, line);
            touch_vector along = touch_scale(square > 1e-12 ? touch_dot(way, line) / square : 0.0, line);
            if (touch_magnitude(along) > longest && touch_is_free_way(along, planes))
                best = along, longest = touch_magnitude(along);
        }
    }
    return best;
}

/* Add the surface that the proxy has just met. It replaces one of about the same normal. A proxy on one surface leaves it
   for the next, as over an edge; only once it comes back to the one before do both stop it, as in a corner. */
static inline void touch_add_plane(touch_planes *planes, touch_vector normal) {
    touch_vector *known = planes->normal;
    if (touch_dot(known[0], normal) > TOUCH_PROXY_SAME_NORMAL) {
        known[0] = normal;
        if (planes->count < 1) planes->count = 1;
    } else if (planes->count <= 1) {
        planes->count = touch_dot(known[1], normal) > TOUCH_PROXY_SAME_NORMAL ? 2 : 1;
        known[1] = known[0], known[0] = normal;
    } else if (touch_dot(known[1], normal) > TOUCH_PROXY_SAME_NORMAL) {
        known[1] = normal;
    } else {
        known[2] = normal, planes->count = 3;
    }
}

/* -- the search of a tick --------------------------------------------------------------------------------------------- */

/* Move a proxy out of a surface that came over it, some steps, and onto the surface. */
static inline touch_contact touch_push_out(const touch_wall *s, touch_contact at) {
    for (int n = 0; n < TOUCH_PROXY_STEPS && at.force_n > TOUCH_PROXY_SLIDE_LEVELS * s->level_n; n++) {
        double way = touch_fmin((at.force_n - s->level_n) / s->stiffness_n_per_m, s->max_step_m);
        at = touch_probe(s, touch_add_scaled(at.position_m, way, at.normal));
    }
    return at.force_n > s->level_n ? touch_move_onto_surface(s, at) : at;
}

/* Adapt the length of the steps: shorter where the way turns back over an edge, so that the proxy comes to rest between, and
   longer again where it goes on. */
static inline void touch_adapt_step(const touch_wall *s, touch_vector way, touch_vector before, double *step_m,
                                    double *growth) {
    double cosine = touch_dot(way, before);
    if (cosine < -TOUCH_PROXY_TURN_BACK * touch_dot(before, before))
        *step_m = 0.4 * *step_m, *growth = 1.0;
    else if (cosine > TOUCH_PROXY_SAME_NORMAL * touch_magnitude(way) * touch_magnitude(before))
        *step_m = touch_fmin(*growth * *step_m, s->max_step_m);
}

/* Bring the end of a step onto the surface. 0: it cannot be found, as where forces turn within a sample. */
static inline int touch_find_surface(const touch_wall *s, touch_contact at, touch_vector way, int is_sliding,
                                     touch_vector hand_m, touch_contact *next) {
    double max_approach = is_sliding ? 0.5 * touch_magnitude(way) : 0.0;
    if (next->force_n <= TOUCH_PROXY_SLIDE_LEVELS * s->level_n && touch_dot(next->normal, way) <= max_approach) {
        *next = touch_move_onto_surface(s, *next);
    } else if (next->force_n > s->level_n) {
        if (at.force_n > s->level_n) return 0; /* no way in can be sought from within */
        *next = touch_find_crossing(s, at, *next);
    }
    double farther = touch_magnitude(touch_subtract(hand_m, next->position_m));
    farther -= touch_magnitude(touch_subtract(hand_m, at.position_m));
    return !(next->force_n > TOUCH_PROXY_OFF_LEVELS * s->level_n || farther > s->max_step_m);
}

/* Move `*position_m` to where the proxy comes to without friction; whether a surface stops it there. */
static inline int touch_seek_goal(const touch_wall *s, touch_vector hand_m, touch_vector *position_m) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_planes planes = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}, 0};
    touch_contact at = touch_push_out(s, touch_probe(s, *position_m));
    if (at.force_n > 0.9 * s->level_n) touch_add_plane(&planes, touch_steady_normal(s, at));
    touch_vector before = touch_zero();
    int left_planes = 0; /* how many planes the proxy left; they hold on where no step is left to find out */
    double growth = 2.0, step_m = s->max_step_m, min_step_m = TOUCH_PROXY_MIN_STEP * s->max_step_m;
    if (proxy->is_in_contact) step_m = touch_fmax(proxy->step_m, 2.0 * min_step_m);
    for (int n = 0; n < TOUCH_PROXY_STEPS; n++) {
        touch_vector way = touch_allowed_way(touch_subtract(hand_m, at.position_m), &planes);
        double length = touch_magnitude(way);
        touch_adapt_step(s, way, before, &step_m, &growth);
        if (length <= TOUCH_PROXY_NO_WAY_M || step_m < min_step_m) break;
        before = way;
        touch_contact next = touch_probe(s, touch_add_scaled(at.position_m, touch_fmin(length, step_m) / length, way));
        int is_leaving = touch_dot(touch_subtract(hand_m, next.position_m), next.normal) >= 0.0;
        if (next.force_n <= s->level_n && (next.force_n < 0.5 * s->level_n || is_leaving)) {
            if (!planes.count && length <= step_m) { /* the hand itself is free */
                *position_m = next.position_m;
                return 0;
            }
            if (planes.count > left_planes) left_planes = planes.count;
            at = next, planes.count = 0;
            continue;
        }
        if (!touch_find_surface(s, at, way, planes.count > 0, hand_m, &next)) {
            /* a force that begins with a jump has no point at the level: the proxy stays in front of it */
            if (!planes.count && at.force_n <= s->level_n && next.force_n > s->level_n) touch_add_plane(&planes, next.normal);
            break;
        }
        at = next;
        touch_add_plane(&planes, touch_steady_normal(s, at));
    }
    int count = planes.count > 0 ? planes.count : left_planes;
    proxy->step_m = step_m, *position_m = at.position_m;
    return count > 0 && touch_dot(touch_subtract(hand_m, at.position_m), planes.normal[count - 1]) < 0.0;
}

/* -- bodies that move ------------------------------------------------------------------------------------------------- */

/* Where a body has carried the proxy of the tick before. */
static inline touch_vector touch_carried_position(const touch_wall *s) {
    const touch_proxy *proxy = &s->receiver->state.proxy;
    if (proxy->body < 0 || proxy->body >= touch_body_count(s->instant)) return proxy->position_m;
    touch_matrix rotation = touch_body_rotation(s->instant, proxy->body);
    return touch_add(touch_rotate(&rotation, proxy->body_position_m), touch_body_position(s->instant, proxy->body));
}

/* Store the position of the proxy, also in the axes of the body that pushes most there. */
static inline void touch_store_proxy(const touch_wall *s, touch_vector position_m, int is_in_contact) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    const touch_body_pose *poses = (const touch_body_pose *)(s->instant->before + 1);
    proxy->is_active = 1, proxy->is_in_contact = is_in_contact, proxy->body = -1;
    proxy->position_m = position_m;
    if (!is_in_contact || poses->is_identity) return; /* voxels carry nothing */
    int64_t body = touch_strongest_body(s->instant, position_m);
    if (body < 0) return;
    touch_matrix rotation = touch_body_rotation(s->instant, body);
    touch_vector arm = touch_subtract(position_m, touch_body_position(s->instant, body));
    proxy->body = body, proxy->body_position_m = touch_rotate_back(&rotation, arm);
}

/* -- the force -------------------------------------------------------------------------------------------------------- */

/* Where friction leaves a proxy on its way to the goal: at most `max_m` from there. */
static inline touch_vector touch_drag(const touch_wall *s, touch_vector before_m, touch_vector goal_m, double max_m) {
    touch_vector way = touch_subtract(before_m, goal_m);
    double length = touch_magnitude(way);
    if (length <= max_m) return before_m;
    touch_vector position = touch_add_scaled(goal_m, max_m / length, way);
    if (max_m > 0.0) {
        touch_contact at = touch_probe(s, position);
        if (at.force_n > 0.5 * s->level_n) position = touch_move_onto_surface(s, at).position_m;
    }
    return position;
}

/* Depth of a proxy below the surface that the ramp of forces behind it extrapolates to, metres; negative above. Two samples
   behind the surface the low-pass of the field is over. Where the force has its maximum before that, or the wall ends, the
   force half as far behind is taken, with a margin. */
static inline double touch_ramp_depth(const touch_wall *s, touch_vector position_m, touch_vector inwards, double depth_m) {
    double sample = touch_sample_length(s, inwards), k = s->stiffness_n_per_m;
    double far_n = touch_probe(s, touch_add_scaled(position_m, TOUCH_PROXY_RAMP_SAMPLES * sample, inwards)).force_n;
    double near_n = touch_probe(s, touch_add_scaled(position_m, sample, inwards)).force_n;
    double depth = far_n / k - TOUCH_PROXY_RAMP_SAMPLES * sample;
    depth = touch_fmax(depth, near_n / k - (1.0 + TOUCH_PROXY_RAMP_DOUBT) * sample);
    depth = touch_fmax(depth, -sample);
    return touch_fmin(touch_fmin(depth, sample), 0.5 * depth_m);
}

/* The force of the proxy on a hand, N, without friction; `*friction_n` is what friction adds. */
static inline touch_vector touch_contact_force(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m,
                                               touch_vector *friction_n) {
    const touch_settings *settings = &receiver->settings;
    const touch_tick_state *state = &receiver->state;
    touch_wall s = {receiver, t, settings->wall_n_per_m, settings->wall_level_n, 0.0, settings->wall_spacing_m};
    s.max_step_m = 0.5 * touch_fmin(touch_fmin(s.spacing_m.x, s.spacing_m.y), s.spacing_m.z);
    int was_in_contact = state->proxy.is_active && state->proxy.is_in_contact;
    touch_vector before = state->proxy.is_active ? touch_carried_position(&s) : hand_m, goal = before;
    *friction_n = touch_zero();
    if (!touch_seek_goal(&s, hand_m, &goal)) {
        touch_store_proxy(&s, goal, 0);
        return touch_zero();
    }
    touch_vector pull = touch_subtract(goal, hand_m);
    double k = 1.0 / (1.0 / s.stiffness_n_per_m + state->softness_m_per_n); /* softer where the loop would be unstable */
    double depth = touch_magnitude(pull), mu = state->friction;
    touch_vector outwards = touch_scale(1.0 / depth, pull);
    double force = touch_fmax(0.0, k * (depth + touch_ramp_depth(&s, goal, touch_scale(-1.0, outwards), depth)));
    touch_vector position = was_in_contact ? touch_drag(&s, before, goal, mu * force / k) : goal;
    touch_store_proxy(&s, position, 1);
    touch_vector way = touch_subtract(position, goal);
    /* moved onto the surface the proxy may be a little farther off than friction allows */
    double max_fraction = mu * force / touch_fmax(k * touch_magnitude(way), 1e-12);
    *friction_n = touch_scale(k * touch_fmin(1.0, max_fraction), way);
    return touch_scale(force, outwards);
}

#endif
