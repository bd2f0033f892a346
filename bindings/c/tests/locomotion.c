// A character walks over a step and jumps; a vehicle drives and stops.
//
// Arguments: the server's address and fingerprint.

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

static void check(RhumbCode code, const char *what) {
    if (code != RHUMB_CODE_OK) {
        fprintf(stderr, "%s: code %u: %s\n", what, (unsigned)code, rhumb_last_error());
        exit(1);
    }
}

static void expect_near(float got, float expected, float within, const char *what) {
    if (!(fabsf(got - expected) <= within)) {
        fprintf(stderr, "%s is %f and not %f\n", what, (double)got, (double)expected);
        exit(1);
    }
}

static void advance(RhumbScene scene, int ticks) {
    for (int tick = 0; tick < ticks; tick++) check(rhumb_scene_advance(scene, 0, NULL), "advance");
}

static const float *position(RhumbScene scene, RhumbBody body) {
    RhumbPoses poses;
    size_t place;
    check(rhumb_scene_poses(scene, &poses), "poses");
    check(rhumb_scene_place(scene, body, &place), "place");
    return poses.positions + 3 * place;
}

static RhumbBody add(RhumbScene scene, RhumbBodyKind kind, const float half[3], const float at[3]) {
    RhumbBodyDesc desc;
    RhumbBody body;
    check(rhumb_body_desc_init(&desc), "desc");
    desc.kind = kind;
    desc.shape.kind = RHUMB_SHAPE_KIND_CUBOID;
    memcpy(desc.shape.half_extents, half, sizeof desc.shape.half_extents);
    memcpy(desc.position, at, sizeof desc.position);
    desc.has_mass = kind == RHUMB_BODY_KIND_DYNAMIC;
    desc.mass = 1000;
    check(rhumb_scene_add_bodies(scene, &desc, 1, &body), "add");
    return body;
}

static void walk(RhumbScene scene, RhumbBody body, float speed) {
    const RhumbCommand command = {.kind = RHUMB_COMMAND_KIND_SET_VELOCITY, .body = body, .vector = {speed, 0, 0}};
    check(rhumb_scene_command(scene, &command, 1, NULL), "velocity");
}

// True if an event of this kind about the body came since the last call.
static bool came(RhumbScene scene, RhumbEventKind kind, RhumbBody body) {
    bool has_come = false;
    for (;;) {
        RhumbEvent event;
        check(rhumb_scene_poll_event(scene, &event), "event");
        if (event.kind == RHUMB_EVENT_KIND_NONE) return has_come;
        if (event.kind == RHUMB_EVENT_KIND_COMMAND_REFUSED) {
            fprintf(stderr, "refused: %s\n", event.text);
            exit(1);
        }
        has_come = has_come || (event.kind == kind && event.body == body);
    }
}

static void character(RhumbScene scene) {
    const float step[] = {1, 0.1f, 2}, step_at[] = {3, 0.1f, 0}, half[] = {0.3f, 0.9f, 0.3f}, at[] = {0, 0.92f, 0};
    add(scene, RHUMB_BODY_KIND_FIXED, step, step_at);
    const RhumbBody body = add(scene, RHUMB_BODY_KIND_KINEMATIC, half, at);
    RhumbCharacter character;
    check(rhumb_character_init(&character, RHUMB_COORDINATES_RHUMB), "character");
    character.has_step = 1;
    character.step_height = 0.3f;
    character.step_width = 0.1f;
    check(rhumb_scene_set_character(scene, body, &character, NULL), "set character");
    walk(scene, body, 2);
    advance(scene, 90);
    walk(scene, body, 0);
    advance(scene, 10);
    if (!came(scene, RHUMB_EVENT_KIND_REACHED_GROUND, body)) abort();
    expect_near(position(scene, body)[0], 3, 0.35f, "the way of the character");
    expect_near(position(scene, body)[1], 1.12f, 0.08f, "its height on the step");
    const float stood = position(scene, body)[0];
    advance(scene, 30);
    expect_near(position(scene, body)[0], stood, 0.05f, "its place");
    const RhumbCommand jump = {.kind = RHUMB_COMMAND_KIND_JUMP, .body = body, .number = 5};
    check(rhumb_scene_command(scene, &jump, 1, NULL), "jump");
    advance(scene, 30);
    if (!came(scene, RHUMB_EVENT_KIND_LEFT_GROUND, body)) abort();
    if (position(scene, body)[1] < 2) abort();
    // An ordinary kinematic body does not fall.
    check(rhumb_scene_clear_locomotion(scene, body, NULL), "clear");
    advance(scene, 60);
    if (position(scene, body)[1] < 2) abort();
}

static void vehicle(RhumbScene scene) {
    const float half[] = {0.8f, 0.2f, 1.6f}, at[] = {20, 0.7f, 0};
    const RhumbBody body = add(scene, RHUMB_BODY_KIND_DYNAMIC, half, at);
    RhumbWheel wheels[4];
    for (int i = 0; i < 4; i++) {
        check(rhumb_wheel_init(&wheels[i], RHUMB_COORDINATES_RHUMB), "wheel");
        wheels[i].position[0] = i % 2 == 0 ? -0.8f : 0.8f;
        wheels[i].position[1] = -0.1f;
        wheels[i].position[2] = i < 2 ? -1.2f : 1.2f;
    }
    uint64_t last = 0;
    check(rhumb_scene_set_vehicle(scene, body, wheels, 4, &last), "vehicle");
    if (last == 0) abort();
    advance(scene, 60);
    expect_near(position(scene, body)[1], 0.65f, 0.08f, "the chassis on its springs");
    RhumbWheelInput inputs[4] = {{0}};
    inputs[2].force = inputs[3].force = 1000;
    check(rhumb_scene_set_wheels(scene, body, inputs, 4, NULL), "force");
    advance(scene, 120);
    // Two kilonewtons give a ton 2 m/s².
    expect_near(position(scene, body)[2], -4, 0.5f, "the way of the vehicle");
    expect_near(position(scene, body)[0], 20, 0.1f, "its side");
    for (int i = 0; i < 4; i++) {
        inputs[i].force = 0;
        inputs[i].brake = 3000;
    }
    check(rhumb_scene_set_wheels(scene, body, inputs, 4, NULL), "brake");
    advance(scene, 120);
    const float stopped = position(scene, body)[2];
    advance(scene, 60);
    expect_near(position(scene, body)[2], stopped, 0.1f, "the place where it stopped");
    came(scene, RHUMB_EVENT_KIND_NONE, 0);
}

int main(int count, char **arguments) {
    if (count != 3) return 2;
    RhumbConnectOptions server = {.address = arguments[1], .fingerprint = arguments[2], .timeout_s = 30};
    RhumbConnection connection;
    RhumbScene scene;
    check(rhumb_connect(&server, &connection), "connect");
    check(rhumb_join(connection, "locomotion", NULL, &scene), "join");
    const float floor[] = {50, 0.5f, 50}, below[] = {0, -0.5f, 0};
    add(scene, RHUMB_BODY_KIND_FIXED, floor, below);
    character(scene);
    vehicle(scene);
    check(rhumb_scene_delete(scene), "delete");
    check(rhumb_scene_close(scene), "close");
    puts("the character walked and the vehicle drove");
    return 0;
}
