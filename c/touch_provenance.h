/* touch_provenance.h: what the provenance of a file (record PROV, touch_file.provenance in touch.h) states for rendering. Keys
   are those that src/touchfield writes; values that are JSON are scanned here without memory of their own. */
#ifndef TOUCH_PROVENANCE_H
#define TOUCH_PROVENANCE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef struct { /* bytes of UTF-8; NULL: there is no such text */
    const char *at;
    uint64_t size;
} touch_stated_text;

static inline int touch_text_is(touch_stated_text text, const char *expected) {
    return text.at && text.size == strlen(expected) && !memcmp(text.at, expected, (size_t)text.size);
}

/* The value of a key in the payload of PROV: u16 pairs, then u16 size and bytes of each key and value. */
static inline touch_stated_text touch_provenance_of(const uint8_t *record, uint64_t size, const char *key) {
    touch_stated_text none = {NULL, 0}, part[2] = {{NULL, 0}, {NULL, 0}};
    uint64_t at = 2;
    for (uint64_t n = 0; size >= 2 && n < 2u * (record[0] | (unsigned)record[1] << 8); n++) {
        if (size - at < 2) return none;
        uint64_t length = record[at] | (unsigned)record[at + 1] << 8;
        at += 2;
        if (size - at < length) return none;
        part[n & 1].at = (const char *)record + at, part[n & 1].size = length;
        at += length;
        if ((n & 1) && touch_text_is(part[0], key)) return part[1];
    }
    return none;
}

/* -- JSON ------------------------------------------------------------------------------------------------------------- */

static inline int touch_is_json_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

static inline touch_stated_text touch_trimmed(const char *start, const char *stop) {
    while (start < stop && touch_is_json_space(*start)) start++;
    while (start < stop && touch_is_json_space(stop[-1])) stop--;
    touch_stated_text out = {start, (uint64_t)(stop - start)};
    return out;
}

/* The closing quote of a string that begins at `at`; NULL: there is none. */
static inline const char *touch_json_quote(const char *at, const char *stop) {
    for (; at < stop && *at != '"'; at++)
        if (*at == '\\' && at + 1 < stop) at++;
    return at < stop ? at : NULL;
}

/* The value of a member of an object, as it is written, without spaces around it. The last one counts, as in Python. A text
   whose brackets do not match has none; what else is wrong with it is not looked for. */
static inline touch_stated_text touch_json_member(touch_stated_text json, const char *key) {
    touch_stated_text none = {NULL, 0}, found = none, string = none;
    const char *at = json.at, *stop = at + json.size, *value = NULL;
    int64_t depth = 0;
    if (!json.at) return none;
    for (; at < stop; at++) {
        if (*at == '"') {
            const char *start = at + 1;
            if (!(at = touch_json_quote(start, stop))) return none;
            string.at = start, string.size = (uint64_t)(at - start);
        } else if (*at == ':' && depth == 1) {
            value = touch_text_is(string, key) ? at + 1 : NULL;
        } else if (*at == '{' || *at == '[') {
            if (!depth++ && *at != '{') return none;
        } else if (*at == '}' || *at == ']' || (*at == ',' && depth == 1)) {
            if (value && depth == 1) found = touch_trimmed(value, at), value = NULL;
            if (*at != ',' && --depth <= 0) break;
        } else if (!depth && !touch_is_json_space(*at)) {
            return none;
        }
    }
    return at < stop && !depth && !touch_trimmed(at + 1, stop).size ? found : none;
}

/* Digits from `*at` on: their number; as many as fit are added to `*mantissa`, the others to `*exponent`. */
static inline int touch_json_digits(const char **at, const char *stop, double *mantissa, int *exponent) {
    int count = 0;
    for (; *at < stop && **at >= '0' && **at <= '9'; (*at)++, count++) {
        if (*mantissa < 1e14) *mantissa = 10.0 * *mantissa + (**at - '0'); /* exact below 2^53 */
        else (*exponent)++;
    }
    return count;
}

/* A number of JSON, in any locale; not a number: it is none. Right to the last bit up to 15 digits and 10^22. */
static inline double touch_json_number(touch_stated_text text) {
    const char *at = text.at, *stop = at + text.size;
    double mantissa = 0.0, power = 0.0, sign = 1.0;
    int exponent = 0, ignored = 0;
    if (text.at && at < stop && *at == '-') sign = -1.0, at++;
    if (!text.at || !touch_json_digits(&at, stop, &mantissa, &exponent)) return (double)NAN;
    if (at < stop && *at == '.') {
        const char *point = ++at;
        if (!touch_json_digits(&at, stop, &mantissa, &exponent)) return (double)NAN;
        exponent -= (int)(at - point);
    }
    if (at < stop && (*at == 'e' || *at == 'E')) {
        int is_negative = ++at < stop && *at == '-';
        if (at < stop && (*at == '-' || *at == '+')) at++;
        if (!touch_json_digits(&at, stop, &power, &ignored)) return (double)NAN;
        exponent += (int)(is_negative ? -fmin(power, 9999.0) : fmin(power, 9999.0));
    }
    if (at != stop) return (double)NAN;
    return sign * (exponent < 0 ? mantissa / pow(10.0, -exponent) : mantissa * pow(10.0, exponent));
}

/* -- what is stated --------------------------------------------------------------------------------------------------- */

#define TOUCH_MIN_STATED_N_PER_M 1.0 /* stiffness that a file may state */
#define TOUCH_MAX_STATED_N_PER_M 5000.0

/* The stiffness of walls that the specification of an encoder states, N/m; 0: none that is valid. */
static inline double touch_specified_wall(touch_stated_text spec) {
    double stated = touch_json_number(touch_json_member(spec, "stiffness_n_per_m"));
    if (!touch_text_is(touch_json_member(spec, "law"), "\"penalty\"")) return 0.0;
    return stated >= TOUCH_MIN_STATED_N_PER_M && stated <= TOUCH_MAX_STATED_N_PER_M ? stated : 0.0;
}

/* The same, of a record PROV: a stream that was encoded again has the stiffness of its source, and an edited one has none. */
static inline double touch_stated_wall(const uint8_t *record, uint64_t size) {
    touch_stated_text spec = touch_provenance_of(record, size, "source.spec");
    if (touch_provenance_of(record, size, "edits").at) return 0.0;
    return touch_specified_wall(spec.at ? spec : touch_provenance_of(record, size, "spec"));
}

#endif
