// The script that every language runs; it prints the hash of all poses.
//
// Arguments: the server's address and fingerprint. tests/tests/processes/bindings/script.rs is the same script in Rust.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

enum { PILED = 60, BUILT = 5, BODIES = 1 + PILED + BUILT, TICKS = 150, HINGE = 7 };

static void check(RhumbCode code, const char *what) {
    if (code != RHUMB_CODE_OK) {
        fprintf(stderr, "%s: code %u: %s\n", what, (unsigned)code, rhumb_last_error());
        exit(1);
    }
}

// FNV-1a of 64 bits.
static uint64_t fold(uint64_t hash, const float *numbers, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint32_t bits;
        memcpy(&bits, &numbers[i], sizeof bits);
        for (int byte = 0; byte < 4; byte++) {
            hash = (hash ^ ((bits >> (8 * byte)) & 0xff)) * 0x100000001b3u;
        }
    }
    return hash;
}

static RhumbBodyDesc piled(int i) {
    RhumbBodyDesc desc;
    check(rhumb_body_desc_init(&desc), "init");
    const RhumbShapeKind kinds[] = {
        RHUMB_SHAPE_KIND_BALL, RHUMB_SHAPE_KIND_CUBOID, RHUMB_SHAPE_KIND_CAPSULE, RHUMB_SHAPE_KIND_CYLINDER, RHUMB_SHAPE_KIND_CONE,
    };
    desc.shape.kind = kinds[i % 5];
    desc.shape.radius = 0.25f;
    desc.shape.half_height = 0.5f;
    desc.shape.half_extents[1] = 0.25f;
    desc.position[0] = (float)(i % 2) * 1.25f - 0.625f;
    desc.position[1] = 1.0f + 1.5f * (float)(i / 4);
    desc.position[2] = (float)(i / 2 % 2) * 1.25f - 0.625f;
    desc.angular_velocity[1] = 0.5f * (float)(i % 3);
    return desc;
}

static RhumbShape plain_shape(void) {
    RhumbBodyDesc plain;
    check(rhumb_body_desc_init(&plain), "init");
    return plain.shape;
}

// The shapes and parts of the compound.
typedef struct {
    RhumbShape ball, box;
    RhumbPart parts[3];
} Dumbbell;

// A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car.
static void describe_built(RhumbBodyDesc *descs, Dumbbell *dumbbell) {
    dumbbell->ball = dumbbell->box = plain_shape();
    dumbbell->ball.radius = 0.25f;
    dumbbell->box.kind = RHUMB_SHAPE_KIND_CUBOID;
    dumbbell->box.half_extents[0] = 0.125f;
    dumbbell->box.half_extents[2] = 0.25f;
    const RhumbPart parts[] = {
        {.position = {-0.5f, 0, 0}, .rotation = {0, 0, 0, 1}, .shape = &dumbbell->ball},
        {.position = {0.5f, 0, 0}, .rotation = {0, 0, 0, 1}, .shape = &dumbbell->ball},
        {.position = {0, 0, 0.25f}, .rotation = {0.5f, 0.5f, 0.5f, 0.5f}, .shape = &dumbbell->box},
    };
    memcpy(dumbbell->parts, parts, sizeof parts);
    const float places[BUILT][3] = {{-4, 2, 0}, {4, 4, 0}, {4, 2.5f, 0}, {7, 1, 3}, {-7, 1, 5}};
    for (int i = 0; i < BUILT; i++) {
        check(rhumb_body_desc_init(&descs[i]), "init");
        descs[i].shape.kind = RHUMB_SHAPE_KIND_CUBOID;
        descs[i].shape.half_extents[0] = descs[i].shape.half_extents[1] = descs[i].shape.half_extents[2] = 0.25f;
        memcpy(descs[i].position, places[i], sizeof places[i]);
    }
    descs[0].shape.kind = RHUMB_SHAPE_KIND_COMPOUND;
    descs[0].shape.parts = dumbbell->parts;
    descs[0].shape.part_count = 3;
    descs[1].kind = RHUMB_BODY_KIND_FIXED;
    descs[2].shape.half_extents[1] = 1;
    descs[3].kind = RHUMB_BODY_KIND_KINEMATIC;
    descs[3].shape.kind = RHUMB_SHAPE_KIND_CAPSULE;
    descs[3].shape.half_height = 0.5f;
    descs[3].shape.radius = 0.25f;
    descs[4].shape.half_extents[0] = 0.75f;
    descs[4].shape.half_extents[2] = 1.5f;
}

// Lets the walker walk and the car roll.
static void set_moving(RhumbScene scene, const RhumbBody *bodies) {
    RhumbCharacter character;
    check(rhumb_character_init(&character, RHUMB_COORDINATES_RHUMB), "character");
    character.has_step = 1;
    character.step_height = 0.5f;
    character.step_width = 0.125f;
    check(rhumb_scene_set_character(scene, bodies[PILED + 4], &character, NULL), "set character");
    const RhumbCommand walk = {
        .kind = RHUMB_COMMAND_KIND_SET_VELOCITY, .body = bodies[PILED + 4], .vector = {-1, 0, -0.5f}};
    check(rhumb_scene_command(scene, &walk, 1, NULL), "walk");
    RhumbWheel wheels[4];
    for (int i = 0; i < 4; i++) {
        check(rhumb_wheel_init(&wheels[i], RHUMB_COORDINATES_RHUMB), "wheel");
        wheels[i].position[0] = i % 2 == 0 ? -0.75f : 0.75f;
        wheels[i].position[1] = -0.125f;
        wheels[i].position[2] = i < 2 ? -1.25f : 1.25f;
        wheels[i].radius = 0.25f;
    }
    check(rhumb_scene_set_vehicle(scene, bodies[PILED + 5], wheels, 4, NULL), "vehicle");
}

static RhumbJointDesc hinge(const RhumbBody *bodies) {
    RhumbJointDesc desc;
    check(rhumb_joint_desc_init(&desc), "hinge");
    desc.kind = RHUMB_JOINT_KIND_REVOLUTE;
    desc.first = bodies[PILED + 2];
    desc.second = bodies[PILED + 3];
    desc.first_frame.anchor[1] = -0.5f;
    desc.second_frame.anchor[1] = 1;
    desc.limited_axes = desc.motor_axes = 1u << 3;
    desc.least[3] = -0.5f;
    desc.most[3] = 1;
    return desc;
}

static RhumbCommand command(RhumbCommandKind kind, RhumbBody body, float x, float y, float z) {
    RhumbCommand command = {.kind = kind, .body = body, .vector = {x, y, z}, .rotation = {0, 0, 0, 1}};
    return command;
}

static void interfere(RhumbScene scene, int tick, const RhumbBody *bodies) {
    if (tick == 20) {
        const RhumbWheelInput front = {.steering = 0.25f}, rear = {.force = 2000};
        const RhumbWheelInput inputs[] = {front, front, rear, rear};
        check(rhumb_scene_set_wheels(scene, bodies[PILED + 5], inputs, 4, NULL), "wheels");
    } else if (tick == 30) {
        RhumbCommand commands[] = {
            command(RHUMB_COMMAND_KIND_IMPULSE, bodies[1], 200, 100, 0),
            command(RHUMB_COMMAND_KIND_SET_VELOCITY, bodies[6], 0, 4, 1),
        };
        commands[1].angular[0] = 1;
        check(rhumb_scene_command(scene, commands, 2, NULL), "commands");
    } else if (tick == 40) {
        RhumbCommand jump = command(RHUMB_COMMAND_KIND_JUMP, bodies[PILED + 4], 0, 0, 0);
        jump.number = 4;
        check(rhumb_scene_command(scene, &jump, 1, NULL), "jump");
    } else if (tick == 60) {
        RhumbCommand removal = command(RHUMB_COMMAND_KIND_REMOVE_BODY, bodies[4], 0, 0, 0);
        check(rhumb_scene_command(scene, &removal, 1, NULL), "removal");
        // The other cones have its shape.
        size_t unused = 1;
        check(rhumb_scene_remove_unused_shapes(scene, &unused), "unused shapes");
        if (unused != 0) {
            fprintf(stderr, "%zu shapes are unused\n", unused);
            exit(1);
        }
    } else if (tick == 75) {
        RhumbJointDesc changed = hinge(bodies);
        changed.motor_position[3] = 0.75f;
        changed.motor_stiffness[3] = 30;
        changed.motor_damping[3] = 5;
        check(rhumb_scene_change_joint(scene, HINGE, &changed, NULL), "change");
    } else if (tick == 90) {
        RhumbCommand gravity = command(RHUMB_COMMAND_KIND_SET_GRAVITY, 0, 1, -9.75f, 0);
        check(rhumb_scene_command(scene, &gravity, 1, NULL), "gravity");
    }
}

int main(int count, char **arguments) {
    if (count != 3) return 2;
    RhumbConnectOptions server = {.address = arguments[1], .fingerprint = arguments[2], .timeout_s = 30};
    RhumbConnection connection;
    RhumbScene scene;
    check(rhumb_connect(&server, &connection), "connect");
    RhumbJoinOptions options;
    check(rhumb_join_options_init(&options), "options");
    options.condition = RHUMB_JOIN_CONDITION_CREATE;
    check(rhumb_join(connection, "script", &options, &scene), "join");

    RhumbBodyDesc descs[BODIES];
    Dumbbell dumbbell;
    RhumbBody bodies[BODIES];
    check(rhumb_body_desc_init(&descs[0]), "init");
    descs[0].kind = RHUMB_BODY_KIND_FIXED;
    descs[0].shape.kind = RHUMB_SHAPE_KIND_CUBOID;
    descs[0].shape.half_extents[0] = 10;
    descs[0].shape.half_extents[2] = 10;
    descs[0].position[1] = -0.5f;
    for (int i = 0; i < PILED; i++) descs[1 + i] = piled(i);
    describe_built(&descs[1 + PILED], &dumbbell);
    check(rhumb_scene_add_bodies(scene, descs, BODIES, bodies), "add");
    RhumbJointDesc joint = hinge(bodies);
    joint.motor_velocity[3] = 1;
    joint.motor_damping[3] = 4;
    joint.motor_force[3] = 2000;
    check(rhumb_scene_add_joint(scene, HINGE, &joint, NULL), "joint");
    set_moving(scene, bodies);

    for (int tick = 0; tick < TICKS; tick++) {
        interfere(scene, tick, bodies);
        check(rhumb_scene_advance(scene, 0, NULL), "advance");
    }

    RhumbPoses poses;
    check(rhumb_scene_poses(scene, &poses), "poses");
    uint64_t hash = 0xcbf29ce484222325u;
    for (int i = 0; i < BODIES; i++) {
        size_t place;
        if (rhumb_scene_place(scene, bodies[i], &place) == RHUMB_CODE_INVALID) continue;
        hash = fold(hash, poses.positions + 3 * place, 3);
        hash = fold(hash, poses.rotations + 4 * place, 4);
    }
    RhumbQuery query;
    check(rhumb_query_init(&query), "query");
    query.hits = 8;
    query.position[0] = query.position[2] = -0.625f;
    query.position[1] = 50;
    query.translation[1] = -100;
    RhumbHit hits[8];
    size_t found;
    check(rhumb_scene_query(scene, &query, 1, hits, 8, &found, NULL), "query");
    for (size_t i = 0; i < found; i++) hash = fold(hash, &hits[i].distance, 1);
    printf("%zu bodies, %zu hits, hash %016llx\n", poses.count, found, (unsigned long long)hash);
    check(rhumb_scene_delete(scene), "delete");
    check(rhumb_scene_close(scene), "close");
    return 0;
}
