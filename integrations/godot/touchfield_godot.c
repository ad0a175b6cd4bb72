/* The class TouchfieldReceiver for Godot: the functions of ../unity/touchfield.h as methods. Numbers of Godot's scripts are
   doubles, and those of a Vector3 are floats. The thread that decodes and the loops are in touchfield_player.gd. */
#include "../unity/touchfield.h"

#include "gdextension_interface.h"

#include <stdlib.h>
#include <string.h>

typedef struct { /* an instance; player is NULL before open */
    touchfield *player;
} receiver;

typedef struct { /* a String, StringName or PackedByteArray of Godot, as large as the largest of them */
    void *opaque[2];
} godot_object;

typedef union { /* an argument or a result */
    double number;
    GDExtensionBool flag;
    float vector[3];
    godot_object object;
} godot_value;

typedef void (*method_call)(receiver *self, const godot_value *const *arguments, godot_value *result);

enum { MAX_ARGUMENTS = 2, MAX_OPTION = 64 };

typedef struct {
    const char *name;
    method_call call;
    GDExtensionVariantType result; /* NIL: none */
    uint32_t argument_count;
    struct {
        const char *name;
        GDExtensionVariantType type;
    } argument[MAX_ARGUMENTS];
} method;

/* -- functions of Godot ----------------------------------------------------------------------------------------------- */

static struct {
    GDExtensionInterfaceStringNewWithUtf8Chars new_string;
    GDExtensionInterfaceStringToUtf8Chars string_text;
    GDExtensionInterfaceStringNameNewWithLatin1Chars new_name;
    GDExtensionInterfacePackedByteArrayOperatorIndexConst bytes_at;
    GDExtensionInterfaceVariantGetType type_of;
    GDExtensionInterfaceGetVariantFromTypeConstructor to_variant;
    GDExtensionInterfaceGetVariantToTypeConstructor from_variant;
    GDExtensionInterfaceClassdbConstructObject2 construct;
    GDExtensionInterfaceClassdbGetMethodBind method_of;
    GDExtensionInterfaceClassdbRegisterExtensionClass4 register_class;
    GDExtensionInterfaceClassdbRegisterExtensionClassMethod register_method;
    GDExtensionInterfaceClassdbUnregisterExtensionClass unregister_class;
    GDExtensionInterfaceObjectMethodBindPtrcall call_method;
    GDExtensionInterfaceObjectSetInstance set_instance;
    GDExtensionPtrDestructor free_string, free_bytes;
    GDExtensionPtrBuiltInMethod bytes_size;
    GDExtensionMethodBindPtr notification;
} godot;

static GDExtensionClassLibraryPtr library;
static godot_object class_name, no_name, no_text;

/* Hashes of signatures in Godot's extension_api.json. */
#define HASH_OF_SIZE 3173160232
#define HASH_OF_NOTIFICATION 4023243586

static godot_object name_of(const char *text) {
    godot_object name = {{0}};
    godot.new_name(&name, text, 1);
    return name;
}

static GDExtensionPtrBuiltInMethod builtin_method(GDExtensionInterfaceGetProcAddress of, GDExtensionVariantType type,
                                                  const char *text, GDExtensionInt hash) {
    godot_object name = name_of(text);
    return ((GDExtensionInterfaceVariantGetPtrBuiltinMethod)of("variant_get_ptr_builtin_method"))(type, &name, hash);
}

static GDExtensionPtrDestructor destructor(GDExtensionInterfaceGetProcAddress of, GDExtensionVariantType type) {
    return ((GDExtensionInterfaceVariantGetPtrDestructor)of("variant_get_ptr_destructor"))(type);
}

/* Look up the functions; 0: this Godot is older than 4.4. */
static int find_functions(GDExtensionInterfaceGetProcAddress of) {
    godot.register_class = (GDExtensionInterfaceClassdbRegisterExtensionClass4)of("classdb_register_extension_class4");
    godot.construct = (GDExtensionInterfaceClassdbConstructObject2)of("classdb_construct_object2");
    if (!godot.register_class || !godot.construct) return 0;
    godot.new_string = (GDExtensionInterfaceStringNewWithUtf8Chars)of("string_new_with_utf8_chars");
    godot.string_text = (GDExtensionInterfaceStringToUtf8Chars)of("string_to_utf8_chars");
    godot.new_name = (GDExtensionInterfaceStringNameNewWithLatin1Chars)of("string_name_new_with_latin1_chars");
    godot.bytes_at = (GDExtensionInterfacePackedByteArrayOperatorIndexConst)of("packed_byte_array_operator_index_const");
    godot.type_of = (GDExtensionInterfaceVariantGetType)of("variant_get_type");
    godot.to_variant = (GDExtensionInterfaceGetVariantFromTypeConstructor)of("get_variant_from_type_constructor");
    godot.from_variant = (GDExtensionInterfaceGetVariantToTypeConstructor)of("get_variant_to_type_constructor");
    godot.method_of = (GDExtensionInterfaceClassdbGetMethodBind)of("classdb_get_method_bind");
    godot.register_method =
        (GDExtensionInterfaceClassdbRegisterExtensionClassMethod)of("classdb_register_extension_class_method");
    godot.unregister_class = (GDExtensionInterfaceClassdbUnregisterExtensionClass)of("classdb_unregister_extension_class");
    godot.call_method = (GDExtensionInterfaceObjectMethodBindPtrcall)of("object_method_bind_ptrcall");
    godot.set_instance = (GDExtensionInterfaceObjectSetInstance)of("object_set_instance");
    godot.free_string = destructor(of, GDEXTENSION_VARIANT_TYPE_STRING);
    godot.free_bytes = destructor(of, GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY);
    godot.bytes_size = builtin_method(of, GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY, "size", HASH_OF_SIZE);
    return godot.bytes_size != NULL;
}

/* -- methods ---------------------------------------------------------------------------------------------------------- */

static int64_t nanoseconds(double seconds) { return (int64_t)(1e9 * seconds + 0.5); }

static void open_bytes(receiver *self, const godot_value *const *arguments, godot_value *result) {
    int64_t size = 0;
    if (self->player) return; /* it plays on: result is false */
    godot.bytes_size((GDExtensionTypePtr)(uintptr_t)arguments[0], NULL, &size, 0);
    self->player = touchfield_open(size ? godot.bytes_at(arguments[0], 0) : (const uint8_t *)"", (uint64_t)size);
    result->flag = self->player != NULL;
}

static void set_option(receiver *self, const godot_value *const *arguments, godot_value *result) {
    char option[MAX_OPTION];
    GDExtensionInt size = godot.string_text(arguments[0], option, MAX_OPTION - 1);
    if (size >= MAX_OPTION - 1) return; /* no option has so long a name */
    option[size] = '\0';
    result->flag = touchfield_set(self->player, option, arguments[1]->number) != 0;
}

static void tick(receiver *self, const godot_value *const *arguments, godot_value *result) {
    double force_n[3];
    const float *position_m = arguments[0]->vector;
    touchfield_tick(self->player, position_m[0], position_m[1], position_m[2], nanoseconds(arguments[1]->number), force_n);
    for (int n = 0; n < 3; n++) result->vector[n] = (float)force_n[n];
}

static void is_ready(receiver *self, const godot_value *const *arguments, godot_value *result) {
    result->flag = touchfield_is_ready(self->player, nanoseconds(arguments[0]->number)) != 0;
}

static void seek(receiver *self, const godot_value *const *arguments, godot_value *result) {
    (void)result;
    touchfield_seek(self->player, arguments[0]->number);
}

/* Methods without arguments. */
#define METHOD(name, body)                                                                             \
    static void name(receiver *self, const godot_value *const *arguments, godot_value *result) { \
        (void)arguments, (void)result;                                                                 \
        body;                                                                                          \
    }
METHOD(start, result->flag = touchfield_start(self->player) == 0)
METHOD(decode, result->flag = touchfield_decode(self->player) != 0)
METHOD(resume, touchfield_resume(self->player))
METHOD(pause_medium, touchfield_pause(self->player))
METHOD(stop, touchfield_stop(self->player))
METHOD(is_released, result->flag = touchfield_is_released(self->player) != 0)
METHOD(is_over, result->flag = touchfield_is_over(self->player) != 0)
METHOD(get_error, godot.new_string(&result->object, touchfield_error(self->player)))
METHOD(get_axes, godot.new_string(&result->object, touchfield_axes(self->player)))
METHOD(get_duration_s, result->number = touchfield_duration_s(self->player))
METHOD(get_force_max_n, result->number = touchfield_force_max_n(self->player))
METHOD(get_media_s, result->number = touchfield_media_s(self->player))

#define NIL GDEXTENSION_VARIANT_TYPE_NIL
#define BOOL GDEXTENSION_VARIANT_TYPE_BOOL
#define FLOAT GDEXTENSION_VARIANT_TYPE_FLOAT
#define STRING GDEXTENSION_VARIANT_TYPE_STRING
#define VECTOR3 GDEXTENSION_VARIANT_TYPE_VECTOR3
#define BYTES GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY

static const method METHODS[] = {
    {"open", open_bytes, BOOL, 1, {{"bytes", BYTES}}},
    {"set_option", set_option, BOOL, 2, {{"name", STRING}, {"value", FLOAT}}},
    {"start", start, BOOL, 0, {{0}}},
    {"decode", decode, BOOL, 0, {{0}}},
    {"tick", tick, VECTOR3, 2, {{"position_m", VECTOR3}, {"clock_s", FLOAT}}},
    {"is_ready", is_ready, BOOL, 1, {{"clock_s", FLOAT}}},
    {"resume", resume, NIL, 0, {{0}}},
    {"pause", pause_medium, NIL, 0, {{0}}},
    {"seek", seek, NIL, 1, {{"time_s", FLOAT}}},
    {"stop", stop, NIL, 0, {{0}}},
    {"is_released", is_released, BOOL, 0, {{0}}},
    {"is_over", is_over, BOOL, 0, {{0}}},
    {"get_error", get_error, STRING, 0, {{0}}},
    {"get_axes", get_axes, STRING, 0, {{0}}},
    {"get_duration_s", get_duration_s, FLOAT, 0, {{0}}},
    {"get_force_max_n", get_force_max_n, FLOAT, 0, {{0}}},
    {"get_media_s", get_media_s, FLOAT, 0, {{0}}},
};

/* -- calls from scripts ----------------------------------------------------------------------------------------------- */

/* Call a method; before open, all others return false, zero or an empty text. */
static void call_method(const method *called, receiver *self, const godot_value *const *arguments, godot_value *result) {
    if (self->player || called->call == open_bytes) called->call(self, arguments, result);
    else if (called->result == STRING) godot.new_string(&result->object, "");
}

static size_t size_of(GDExtensionVariantType type) {
    if (type == FLOAT) return sizeof(double);
    if (type == VECTOR3) return 3 * sizeof(float);
    return type == BOOL ? sizeof(GDExtensionBool) : 0; /* a text is made as a whole */
}

/* A call with values of the types that the method states. */
static void call_typed(void *called, GDExtensionClassInstancePtr self, const GDExtensionConstTypePtr *arguments,
                       GDExtensionTypePtr result) {
    const method *typed = (const method *)called;
    if (result) memset(result, 0, size_of(typed->result));
    call_method(typed, (receiver *)self, (const godot_value *const *)arguments, (godot_value *)result);
}

static void free_value(GDExtensionVariantType type, godot_value *value) {
    if (type == STRING) godot.free_string(value);
    if (type == BYTES) godot.free_bytes(value);
}

/* Whether arguments fit the method: an integer is a number, too. */
static int check_arguments(const method *called, const GDExtensionConstVariantPtr *arguments, GDExtensionInt count,
                           GDExtensionCallError *error) {
    uint32_t expected = called->argument_count;
    error->error = GDEXTENSION_CALL_OK;
    error->expected = (int32_t)expected;
    if (count < (GDExtensionInt)expected) error->error = GDEXTENSION_CALL_ERROR_TOO_FEW_ARGUMENTS;
    if (count > (GDExtensionInt)expected) error->error = GDEXTENSION_CALL_ERROR_TOO_MANY_ARGUMENTS;
    for (uint32_t n = 0; n < expected && !error->error; n++) {
        GDExtensionVariantType type = called->argument[n].type, found = godot.type_of(arguments[n]);
        if (found == type || (type == FLOAT && found == GDEXTENSION_VARIANT_TYPE_INT)) continue;
        error->error = GDEXTENSION_CALL_ERROR_INVALID_ARGUMENT;
        error->argument = (int32_t)n, error->expected = (int32_t)type;
    }
    return !error->error;
}

/* A call with variants. */
static void call_variants(void *data, GDExtensionClassInstancePtr self, const GDExtensionConstVariantPtr *arguments,
                          GDExtensionInt count, GDExtensionVariantPtr result, GDExtensionCallError *error) {
    const method *called = (const method *)data;
    godot_value value[MAX_ARGUMENTS], returned;
    const godot_value *pointer[MAX_ARGUMENTS] = {&value[0], &value[1]};
    if (!check_arguments(called, arguments, count, error)) return;
    memset(value, 0, sizeof value), memset(&returned, 0, sizeof returned);
    for (uint32_t n = 0; n < called->argument_count; n++)
        godot.from_variant(called->argument[n].type)(&value[n], (GDExtensionVariantPtr)(uintptr_t)arguments[n]);
    call_method(called, (receiver *)self, pointer, &returned);
    if (called->result != NIL) godot.to_variant(called->result)(result, &returned);
    free_value(called->result, &returned);
    for (uint32_t n = 0; n < called->argument_count; n++) free_value(called->argument[n].type, &value[n]);
}

/* -- the class -------------------------------------------------------------------------------------------------------- */

static GDExtensionObjectPtr create(void *data, GDExtensionBool is_notified) {
    (void)data;
    godot_object parent = name_of("RefCounted");
    receiver *self = (receiver *)calloc(1, sizeof *self);
    if (!self) return NULL;
    GDExtensionObjectPtr object = godot.construct(&parent);
    godot.set_instance(object, &class_name, self);
    int64_t postinitialize = 0;
    GDExtensionBool is_reversed = 0;
    const void *arguments[] = {&postinitialize, &is_reversed};
    if (is_notified && godot.notification) godot.call_method(godot.notification, object, arguments, NULL);
    return object;
}

static void destroy(void *data, GDExtensionClassInstancePtr instance) {
    (void)data;
    receiver *self = (receiver *)instance;
    touchfield_close(self->player);
    free(self);
}

static GDExtensionPropertyInfo property_of(GDExtensionVariantType type, godot_object *name) {
    GDExtensionPropertyInfo info = {type, name, &no_name, 0, &no_text, 6 /* the default usage */};
    return info;
}

static void register_method(const method *added) {
    godot_object name = name_of(added->name), argument_name[MAX_ARGUMENTS];
    GDExtensionPropertyInfo result = property_of(added->result, &no_name), argument[MAX_ARGUMENTS];
    GDExtensionClassMethodArgumentMetadata metadata[MAX_ARGUMENTS] = {GDEXTENSION_METHOD_ARGUMENT_METADATA_NONE};
    for (uint32_t n = 0; n < added->argument_count; n++) {
        argument_name[n] = name_of(added->argument[n].name);
        argument[n] = property_of(added->argument[n].type, &argument_name[n]);
    }
    GDExtensionClassMethodInfo info;
    memset(&info, 0, sizeof info);
    info.name = &name, info.method_userdata = (void *)(uintptr_t)added;
    info.call_func = call_variants, info.ptrcall_func = call_typed;
    info.method_flags = GDEXTENSION_METHOD_FLAGS_DEFAULT;
    info.has_return_value = added->result != NIL, info.return_value_info = &result;
    info.argument_count = added->argument_count, info.arguments_info = argument, info.arguments_metadata = metadata;
    godot.register_method(library, &class_name, &info);
}

static void initialize(void *data, GDExtensionInitializationLevel level) {
    (void)data;
    if (level != GDEXTENSION_INITIALIZATION_SCENE) return;
    godot_object parent = name_of("RefCounted"), object = name_of("Object"), notification = name_of("notification");
    class_name = name_of("TouchfieldReceiver"), no_name = name_of("");
    godot.new_string(&no_text, "");
    godot.notification = godot.method_of(&object, &notification, HASH_OF_NOTIFICATION);
    GDExtensionClassCreationInfo4 info;
    memset(&info, 0, sizeof info);
    info.is_exposed = 1;
    info.create_instance_func = create, info.free_instance_func = destroy;
    godot.register_class(library, &class_name, &parent, &info);
    for (size_t n = 0; n < sizeof METHODS / sizeof *METHODS; n++) register_method(&METHODS[n]);
}

static void deinitialize(void *data, GDExtensionInitializationLevel level) {
    (void)data;
    if (level != GDEXTENSION_INITIALIZATION_SCENE) return;
    godot.unregister_class(library, &class_name);
    godot.free_string(&no_text);
}

/* The entry point, which touchfield.gdextension names. */
TOUCHFIELD_API GDExtensionBool touchfield_init(GDExtensionInterfaceGetProcAddress of, GDExtensionClassLibraryPtr of_class,
                                               GDExtensionInitialization *out) {
    library = of_class;
    godot.new_name = (GDExtensionInterfaceStringNameNewWithLatin1Chars)of("string_name_new_with_latin1_chars");
    if (!godot.new_name || !find_functions(of)) return 0;
    out->minimum_initialization_level = GDEXTENSION_INITIALIZATION_SCENE;
    out->userdata = NULL, out->initialize = initialize, out->deinitialize = deinitialize;
    return 1;
}
