// Misuse of the C interface: each is an error, and none does harm.
//
// Left out is what no library can check: pointers that lie about memory.
//
// Arguments: the server's address, its fingerprint, and its process id. The program ends the server's process.

#include <float.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>

#include "rhumb.h"

// The call returns this code, and an error leaves a sentence.
#define EXPECT(code, call) expect((code), (call), #call, __LINE__)

static void expect(RhumbCode code, RhumbCode got, const char *call, int line) {
    if (got != code) {
        fprintf(stderr, "line %d: %s is %u instead of %u: %s\n", line, call, (unsigned)got, (unsigned)code, rhumb_last_error());
        exit(1);
    }
    if (code != RHUMB_CODE_OK && strlen(rhumb_last_error()) == 0) {
        fprintf(stderr, "line %d: %s says nothing\n", line, call);
        exit(1);
    }
}

static const char *address, *fingerprint;

static RhumbConnection connected(double timeout_s) {
    RhumbConnectOptions server = {.address = address, .fingerprint = fingerprint, .timeout_s = timeout_s};
    RhumbConnection connection;
    EXPECT(RHUMB_CODE_OK, rhumb_connect(&server, &connection));
    return connection;
}

static RhumbScene joined(const char *name, double timeout_s) {
    RhumbScene scene;
    EXPECT(RHUMB_CODE_OK, rhumb_join(connected(timeout_s), name, NULL, &scene));
    return scene;
}

static RhumbBody added(RhumbScene scene) {
    RhumbBodyDesc desc;
    RhumbBody body;
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, NULL));
    return body;
}

static void connecting(void) {
    RhumbConnection connection;
    RhumbConnectOptions server = {.address = address, .fingerprint = fingerprint};
    EXPECT(RHUMB_CODE_NULL, rhumb_connect(NULL, &connection));
    EXPECT(RHUMB_CODE_NULL, rhumb_connect(&server, NULL));
    server.address = NULL;
    EXPECT(RHUMB_CODE_NULL, rhumb_connect(&server, &connection));
    server.address = "no port";
    EXPECT(RHUMB_CODE_CONNECT, rhumb_connect(&server, &connection));
    server.address = "\xff\xfe";
    EXPECT(RHUMB_CODE_INVALID, rhumb_connect(&server, &connection));
    server.address = address;
    server.fingerprint = "17";
    EXPECT(RHUMB_CODE_INVALID, rhumb_connect(&server, &connection));
    server.fingerprint = NULL;
    EXPECT(RHUMB_CODE_INVALID, rhumb_connect(&server, &connection));
    server.fingerprint = fingerprint;
    server.roots = "roots.pem";
    EXPECT(RHUMB_CODE_INVALID, rhumb_connect(&server, &connection));
    server.fingerprint = NULL;
    server.roots = "/there/is/no/such/file.pem";
    EXPECT(RHUMB_CODE_CONNECT, rhumb_connect(&server, &connection));
    server.fingerprint = fingerprint;
    server.roots = NULL;
    const double wrong_times[] = {-1, NAN, INFINITY, DBL_MAX};
    for (size_t i = 0; i < sizeof wrong_times / sizeof *wrong_times; i++) {
        server.timeout_s = wrong_times[i];
        EXPECT(RHUMB_CODE_INVALID, rhumb_connect(&server, &connection));
    }
    // Another server's fingerprint: the trusted one is not there.
    char other[128];
    snprintf(other, sizeof other, "%s", fingerprint);
    other[0] = other[0] == 'a' ? 'b' : 'a';
    server.fingerprint = other;
    server.timeout_s = 5;
    EXPECT(RHUMB_CODE_CONNECT, rhumb_connect(&server, &connection));

    RhumbScene scene;
    RhumbJoinOptions options;
    EXPECT(RHUMB_CODE_NULL, rhumb_join_options_init(NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_join_options_init(&options));
    connection = connected(5);
    EXPECT(RHUMB_CODE_NULL, rhumb_join(connection, NULL, NULL, &scene));
    EXPECT(RHUMB_CODE_NULL, rhumb_join(connection, "misuse", NULL, NULL));
    options.coordinates = 4;
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "misuse", &options, &scene));
    options.coordinates = 0;
    options.tolerance_m = NAN;
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "misuse", &options, &scene));
    options.tolerance_m = 0.05;
    options.condition = RHUMB_JOIN_CONDITION_JOIN;
    EXPECT(RHUMB_CODE_DENIED, rhumb_join(connection, "nowhere", &options, &scene));
    // An error of the server has used the connection up.
    EXPECT(RHUMB_CODE_CLOSED, rhumb_join(connection, "misuse", NULL, &scene));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_connection_close(connection));
    // A wrong name has not.
    connection = connected(5);
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "", NULL, &scene));
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "a name with blanks", NULL, &scene));
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "named", NULL, &scene));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    // Nor has a wrong token, which stays the connection's.
    server.fingerprint = fingerprint;
    server.token = "no\ntoken";
    EXPECT(RHUMB_CODE_OK, rhumb_connect(&server, &connection));
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "named", NULL, &scene));
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "named", NULL, &scene));
    EXPECT(RHUMB_CODE_OK, rhumb_connection_close(connection));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_connection_close(connection));
}

// Every call of a scene, with a handle that is not open.
static void calls_that_need(RhumbScene scene, RhumbCode code) {
    RhumbBodyDesc desc;
    RhumbCommand command = {.kind = RHUMB_COMMAND_KIND_SET_GRAVITY};
    RhumbQuery query;
    RhumbBody body = 1;
    RhumbPoses poses;
    RhumbPoseBuffers buffers = {0};
    RhumbEvent event;
    RhumbHit hit;
    RhumbStatistics statistics;
    size_t count;
    float bound;
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    EXPECT(RHUMB_CODE_OK, rhumb_query_init(&query));
    EXPECT(code, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    EXPECT(code, rhumb_scene_command(scene, &command, 1, NULL));
    RhumbJointDesc joint;
    RhumbBodyState state = {.body = body, .rotation = {0, 0, 0, 1}};
    EXPECT(RHUMB_CODE_OK, rhumb_joint_desc_init(&joint));
    joint.first = 1;
    joint.second = 2;
    EXPECT(code, rhumb_scene_add_joint(scene, 1, &joint, NULL));
    EXPECT(code, rhumb_scene_change_joint(scene, 1, &joint, NULL));
    EXPECT(code, rhumb_scene_remove_joint(scene, 1, NULL));
    RhumbCharacter character;
    RhumbWheel wheel;
    const RhumbWheelInput input = {0};
    EXPECT(RHUMB_CODE_OK, rhumb_character_init(&character, RHUMB_COORDINATES_RHUMB));
    EXPECT(RHUMB_CODE_OK, rhumb_wheel_init(&wheel, RHUMB_COORDINATES_RHUMB));
    EXPECT(code, rhumb_scene_set_character(scene, body, &character, NULL));
    EXPECT(code, rhumb_scene_set_vehicle(scene, body, &wheel, 1, NULL));
    EXPECT(code, rhumb_scene_clear_locomotion(scene, body, NULL));
    EXPECT(code, rhumb_scene_set_wheels(scene, body, &input, 1, NULL));
    EXPECT(code, rhumb_scene_take_authority(scene, &body, 1, 0.02));
    EXPECT(code, rhumb_scene_publish(scene, &state, 1, NULL, NULL));
    EXPECT(code, rhumb_scene_flush(scene));
    EXPECT(code, rhumb_scene_advance(scene, 0, NULL));
    EXPECT(code, rhumb_scene_wait(scene, 0, NULL));
    EXPECT(code, rhumb_scene_poll(scene, NULL));
    EXPECT(code, rhumb_scene_idle(scene, 0));
    EXPECT(code, rhumb_scene_poses(scene, &poses));
    EXPECT(code, rhumb_scene_copy_poses(scene, &buffers, &count));
    EXPECT(code, rhumb_scene_place(scene, body, &count));
    EXPECT(code, rhumb_scene_error_bounds(scene, &body, 1, &bound));
    EXPECT(code, rhumb_scene_tick_error_bounds(scene, 1, &body, 1, &bound));
    EXPECT(code, rhumb_scene_set_lead_ticks(scene, 1));
    EXPECT(code, rhumb_scene_poll_event(scene, &event));
    EXPECT(code, rhumb_scene_query(scene, &query, 1, &hit, 1, &count, NULL));
    EXPECT(code, rhumb_scene_statistics(scene, &statistics));
    EXPECT(code, rhumb_scene_delete(scene));
}

static void handles(void) {
    RhumbScene none = {0}, other = {UINT64_MAX};
    calls_that_need(none, RHUMB_CODE_CLOSED);
    calls_that_need(other, RHUMB_CODE_CLOSED);
    // A handle of another kind is none.
    RhumbConnection connection = connected(5);
    RhumbScene mistaken = {connection.id};
    calls_that_need(mistaken, RHUMB_CODE_CLOSED);
    EXPECT(RHUMB_CODE_OK, rhumb_connection_close(connection));
    RhumbScene scene = joined("handles", 5);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    calls_that_need(scene, RHUMB_CODE_CLOSED);
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_close(scene));
}

static void pointers_and_sizes(RhumbScene scene, RhumbBody body) {
    RhumbBodyDesc desc;
    RhumbQuery query;
    RhumbHit hit;
    RhumbPoseBuffers buffers = {0};
    size_t count = 77;
    float bounds[2];
    EXPECT(RHUMB_CODE_NULL, rhumb_body_desc_init(NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_query_init(NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    EXPECT(RHUMB_CODE_OK, rhumb_query_init(&query));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_bodies(scene, NULL, 1, &body));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_bodies(scene, &desc, 1, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, SIZE_MAX, &body));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_add_bodies(scene, NULL, 0, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_command(scene, NULL, 1, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_command(scene, NULL, 0, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_poses(scene, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_copy_poses(scene, NULL, &count));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_copy_poses(scene, &buffers, NULL));
    EXPECT(RHUMB_CODE_TOO_SMALL, rhumb_scene_copy_poses(scene, &buffers, &count));
    if (count != 1) abort();
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_place(scene, body, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_error_bounds(scene, NULL, 2, bounds));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_error_bounds(scene, &body, 1, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_poll_event(scene, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_statistics(scene, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_query(scene, &query, 1, NULL, 1, &count, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_query(scene, &query, 1, &hit, 1, NULL, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_query(scene, NULL, 1, &hit, 1, &count, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_query(scene, NULL, 0, &hit, 1, &count, NULL));
    // The ball is where it was added.
    query.kind = RHUMB_QUERY_KIND_PROJECTION;
    query.distance = 1000;
    EXPECT(RHUMB_CODE_TOO_SMALL, rhumb_scene_query(scene, &query, 1, NULL, 0, &count, NULL));
    if (count != 1) abort();
    // A pointer that is not aligned for what it points to.
    unsigned char bytes[2 * sizeof(uint64_t)];
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_advance(scene, 0, (uint64_t *)(void *)(bytes + 1)));
}

static void joints_and_authority(RhumbScene scene, RhumbBody body) {
    RhumbJointDesc joint;
    RhumbBodyState state = {.body = body, .rotation = {0, 0, 0, 1}};
    uint8_t published = 77;
    EXPECT(RHUMB_CODE_NULL, rhumb_joint_desc_init(NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_joint_desc_init(&joint));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_joint(scene, 1, NULL, NULL));
    // Of no bodies, with limits of a locked axis, of an unknown kind.
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_joint(scene, 1, &joint, NULL));
    joint.first = joint.second = body;
    joint.limited_axes = 1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_joint(scene, 1, &joint, NULL));
    joint.limited_axes = UINT32_MAX;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_change_joint(scene, 1, &joint, NULL));
    joint.limited_axes = 0;
    joint.kind = 7;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_change_joint(scene, 1, &joint, NULL));
    joint.kind = RHUMB_JOINT_KIND_ROPE;
    joint.length = NAN;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_joint(scene, 1, &joint, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_take_authority(scene, NULL, 1, 0.02));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_authority(scene, &body, 1, NAN));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_authority(scene, &body, SIZE_MAX, 0.02));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_publish(scene, NULL, 1, NULL, NULL));
    // Without authority.
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_publish(scene, &state, 1, &published, NULL));
    state.position[0] = INFINITY;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_publish(scene, &state, 1, &published, NULL));
    if (published != 77) abort();
    // A part that is a compound, and parts that are not there.
    RhumbBodyDesc desc;
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    desc.shape.kind = RHUMB_SHAPE_KIND_COMPOUND;
    RhumbShape nested = desc.shape;
    RhumbPart part = {.rotation = {0, 0, 0, 1}};
    desc.shape.part_count = 1;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    desc.shape.parts = &part;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    part.shape = &nested;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    desc.shape.part_count = SIZE_MAX;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &body));
}

static void locomotion(RhumbScene scene, RhumbBody body) {
    RhumbCharacter character;
    RhumbWheel wheels[17];
    RhumbWheelInput input = {0};
    EXPECT(RHUMB_CODE_NULL, rhumb_character_init(NULL, RHUMB_COORDINATES_RHUMB));
    EXPECT(RHUMB_CODE_INVALID, rhumb_character_init(&character, 4));
    EXPECT(RHUMB_CODE_OK, rhumb_character_init(&character, RHUMB_COORDINATES_RHUMB));
    EXPECT(RHUMB_CODE_NULL, rhumb_wheel_init(NULL, RHUMB_COORDINATES_RHUMB));
    EXPECT(RHUMB_CODE_INVALID, rhumb_wheel_init(wheels, UINT32_MAX));
    for (size_t i = 0; i < 17; i++) EXPECT(RHUMB_CODE_OK, rhumb_wheel_init(&wheels[i], RHUMB_COORDINATES_RHUMB));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_set_character(scene, body, NULL, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_character(scene, 0, &character, NULL));
    character.has_step = 1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_character(scene, body, &character, NULL));
    character.has_step = 0;
    character.mass = NAN;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_character(scene, body, &character, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_set_vehicle(scene, body, NULL, 4, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_vehicle(scene, body, NULL, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_vehicle(scene, body, wheels, SIZE_MAX, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_vehicle(scene, body, wheels, 17, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_vehicle(scene, 0, wheels, 4, NULL));
    wheels[3].axle[0] = 0;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_vehicle(scene, body, wheels, 4, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_clear_locomotion(scene, 0, NULL));
    const RhumbCommand high = {.kind = RHUMB_COMMAND_KIND_JUMP, .body = body, .number = INFINITY};
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, &high, 1, NULL));
    const RhumbCommand unknown = {.kind = RHUMB_COMMAND_KIND_JUMP, .body = body, .number = 1, .choice = 2};
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, &unknown, 1, NULL));
    const RhumbCommand nothing = {.body = body};
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, &nothing, 1, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_set_wheels(scene, body, NULL, 1, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_wheels(scene, body, NULL, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_wheels(scene, body, &input, SIZE_MAX, NULL));
    input.brake = -1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_wheels(scene, body, &input, 1, NULL));
}

// Numbers of joints and bodies that no scene can have. The server would end the connection of a client that sent one.
static void ids_of_no_scene(RhumbScene scene, RhumbBody body) {
    const RhumbBody last = 1 << 20, beyond = last + 1, far = ((RhumbBody)7 << 33) + beyond;
    const uint32_t joints[] = {65536, UINT32_MAX};
    RhumbJointDesc joint;
    EXPECT(RHUMB_CODE_OK, rhumb_joint_desc_init(&joint));
    joint.first = body;
    joint.second = last;
    for (size_t i = 0; i < sizeof joints / sizeof *joints; i++) {
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_joint(scene, joints[i], &joint, NULL));
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_change_joint(scene, joints[i], &joint, NULL));
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_remove_joint(scene, joints[i], NULL));
    }
    RhumbQuery query;
    RhumbHit hit;
    size_t count;
    EXPECT(RHUMB_CODE_OK, rhumb_query_init(&query));
    const RhumbBody bodies[] = {beyond, far};
    for (size_t i = 0; i < sizeof bodies / sizeof *bodies; i++) {
        joint.second = bodies[i];
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_joint(scene, 1, &joint, NULL));
        // One wrong command of two: neither is queued.
        const RhumbCommand commands[] = {
            {.kind = RHUMB_COMMAND_KIND_REMOVE_BODY, .body = body},
            {.kind = RHUMB_COMMAND_KIND_WAKE, .body = bodies[i]},
        };
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, commands, 2, NULL));
        query.except = bodies[i];
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_query(scene, &query, 1, &hit, 1, &count, NULL));
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_authority(scene, &bodies[i], 1, 0.02));
    }
    // The last numbers that a scene can have are sent; the server knows neither.
    const RhumbCommand wake = {.kind = RHUMB_COMMAND_KIND_WAKE, .body = last};
    EXPECT(RHUMB_CODE_OK, rhumb_scene_command(scene, &wake, 1, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_remove_joint(scene, 65535, NULL));
    EXPECT(RHUMB_CODE_REFUSED, rhumb_scene_advance(scene, 0, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_place(scene, body, &count));
}

// A refusal of the server is the code of the next advance, which does its work all the same.
static void refusals(RhumbScene scene, RhumbBody body) {
    uint64_t before, tick, number;
    RhumbRefusal refusal;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, &before));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(scene, &refusal));
    const RhumbCommand wake = {.kind = RHUMB_COMMAND_KIND_WAKE, .body = 77};
    EXPECT(RHUMB_CODE_OK, rhumb_scene_command(scene, &wake, 1, &number));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_take_authority(scene, &body, 1, 0.02));
    EXPECT(RHUMB_CODE_REFUSED, rhumb_scene_advance(scene, 0, &tick));
    if (tick != before + 1 || strstr(rhumb_last_error(), "no body 77") == NULL) abort();
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(scene, &refusal));
    if (!refusal.exists || !refusal.is_command || refusal.number != number || refusal.body != 77) abort();
    if (strcmp(refusal.reason, "unknown body") != 0 || strcmp(refusal.text, "the scene has no body 77") != 0) abort();
    // The other one, now or with the next tick: the ball is not kinematic.
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(scene, &refusal));
    while (!refusal.exists) {
        if (rhumb_scene_advance(scene, 0, NULL) == RHUMB_CODE_REFUSED) {
            EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(scene, &refusal));
        }
    }
    if (refusal.is_command || refusal.body != body || strcmp(refusal.reason, "not kinematic") != 0) abort();
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(scene, &refusal));
    if (refusal.exists) abort();
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_poll_refusal(scene, NULL));
    // Options that no scene has.
    RhumbJoinOptions options;
    RhumbConnection connection = connected(5);
    RhumbScene other;
    EXPECT(RHUMB_CODE_OK, rhumb_join_options_init(&options));
    options.refusals = 2;
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "quiet", &options, &other));
    options.refusals = RHUMB_REFUSALS_EVENTS;
    options.lead_ticks = -1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "quiet", &options, &other));
    options.lead_ticks = 2;
    options.whole_ticks = 1;
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "quiet", &options, &other));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_command(other, &wake, 1, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(other, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_set_lead_ticks(other, NAN));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_set_lead_ticks(other, 1));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(other));
}

static void numbers(RhumbScene scene, RhumbBody body) {
    RhumbBodyDesc desc;
    RhumbBody ignored;
    float bound;
    size_t place;
    const float wrong[] = {NAN, INFINITY, FLT_MAX};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
        desc.position[1] = wrong[i];
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
        RhumbCommand impulse = {.kind = RHUMB_COMMAND_KIND_IMPULSE, .body = body, .vector = {0, wrong[i], 0}};
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, &impulse, 1, NULL));
        EXPECT(RHUMB_CODE_INVALID, rhumb_scene_idle(scene, i == 2 ? -1 : wrong[i]));
    }
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    desc.shape.radius = -1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
    desc.shape.kind = 99;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
    desc.shape.kind = RHUMB_SHAPE_KIND_HULL;
    desc.shape.point_count = 4;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
    // Moments need a mass, and a dynamic body volume.
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    desc.has_moments = 1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    desc.shape.kind = RHUMB_SHAPE_KIND_HALF_SPACE;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_add_bodies(scene, &desc, 1, &ignored));
    // One wrong command of two: neither is queued.
    RhumbCommand commands[2] = {
        {.kind = RHUMB_COMMAND_KIND_REMOVE_BODY, .body = body},
        {.kind = RHUMB_COMMAND_KIND_REMOVE_BODY, .body = 0},
    };
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, commands, 2, NULL));
    commands[1].kind = 1000;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_command(scene, commands, 2, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_error_bounds(scene, &(RhumbBody){body + 1}, 1, &bound));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_place(scene, UINT64_MAX, &place));
    // After all these errors the scene continues, and the body is there.
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_place(scene, body, &place));
}

// A call of another thread, and what came of it.
typedef struct Beside {
    RhumbScene scene;
    RhumbCode (*call)(RhumbScene scene);
    pthread_t thread;
    RhumbCode code;
    atomic_bool is_over;
} Beside;

static RhumbCode idle_long(RhumbScene scene) { return rhumb_scene_idle(scene, 1); }

static RhumbCode advance_one(RhumbScene scene) { return rhumb_scene_advance(scene, 0, NULL); }

static void *call_beside(void *argument) {
    Beside *beside = argument;
    // This thread may be the one that is refused, while the other one looks whether it is inside.
    do {
        beside->code = beside->call(beside->scene);
    } while (beside->code == RHUMB_CODE_BUSY);
    atomic_store(&beside->is_over, true);
    return NULL;
}

static void end(Beside *beside) {
    if (pthread_join(beside->thread, NULL) != 0) abort();
}

// Begins a call in another thread, and returns when that thread is inside it.
static void begin(Beside *beside) {
    for (;;) {
        RhumbCode seen = RHUMB_CODE_OK;
        atomic_store(&beside->is_over, false);
        if (pthread_create(&beside->thread, NULL, call_beside, beside) != 0) abort();
        while (seen == RHUMB_CODE_OK && !atomic_load(&beside->is_over)) {
            sched_yield();
            seen = rhumb_scene_flush(beside->scene);
        }
        if (seen != RHUMB_CODE_OK) {
            EXPECT(RHUMB_CODE_BUSY, seen);
            return;
        }
        // On a machine so busy that this thread did not run meanwhile.
        end(beside);
    }
}

static void two_threads(RhumbScene scene) {
    Beside beside = {.scene = scene, .call = idle_long};
    begin(&beside);
    calls_that_need(scene, RHUMB_CODE_BUSY);
    end(&beside);
    EXPECT(RHUMB_CODE_OK, beside.code);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, NULL));
    // A close beside a call lets the call end.
    begin(&beside);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    end(&beside);
    EXPECT(RHUMB_CODE_OK, beside.code);
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_advance(scene, 0, NULL));
}

static void server_gone(pid_t server) {
    RhumbScene scene = joined("gone", 1);
    RhumbBody body = added(scene);
    RhumbPoses poses;
    // The server stands still, so that the call waits; then it is gone.
    if (kill(server, SIGSTOP) != 0) abort();
    Beside beside = {.scene = scene, .call = advance_one};
    begin(&beside);
    if (kill(server, SIGKILL) != 0) abort();
    end(&beside);
    if (beside.code != RHUMB_CODE_TIMEOUT && beside.code != RHUMB_CODE_ENDED) {
        fprintf(stderr, "a call without a server returned %u\n", (unsigned)beside.code);
        exit(1);
    }
    // The copies are there still.
    size_t place;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poses(scene, &poses));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_place(scene, body, &place));
    if (poses.count != 1 || !isfinite(poses.positions[3 * place + 1])) abort();
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    RhumbConnectOptions options = {.address = address, .fingerprint = fingerprint, .timeout_s = 0.25};
    RhumbConnection connection;
    const RhumbCode again = rhumb_connect(&options, &connection);
    if (again != RHUMB_CODE_CONNECT) EXPECT(RHUMB_CODE_TIMEOUT, again);
}

int main(int count, char **arguments) {
    if (count != 4) return 2;
    address = arguments[1];
    fingerprint = arguments[2];
    if (strlen(rhumb_last_error()) != 0) abort();
    if (rhumb_version() >> 24 != 0) abort();
    connecting();
    handles();
    RhumbScene scene = joined("misuse", 5);
    RhumbBody body = added(scene);
    pointers_and_sizes(scene, body);
    joints_and_authority(scene, body);
    locomotion(scene, body);
    ids_of_no_scene(scene, body);
    refusals(scene, body);
    numbers(scene, body);
    two_threads(scene);
    server_gone((pid_t)atoi(arguments[3]));
    puts("every misuse was an error");
    return 0;
}
