// A scene that the program feeds, in C: what followers see and ask, misuse.

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

// The call returns this code, and an error leaves a sentence.
#define EXPECT(code, call) expect((code), (call), #call, __LINE__)
#define HOLDS(what) holds((what), #what, __LINE__)

static void expect(RhumbCode code, RhumbCode got, const char *call, int line) {
    bool said = code == RHUMB_CODE_OK || strlen(rhumb_last_error()) > 0;
    if (got != code || !said) {
        fprintf(stderr, "line %d: %s is %u instead of %u: %s\n", line, call, (unsigned)got, (unsigned)code, rhumb_last_error());
        exit(1);
    }
}

static void holds(bool is_so, const char *what, int line) {
    if (!is_so) {
        fprintf(stderr, "line %d: does not hold: %s\n", line, what);
        exit(1);
    }
}

static RhumbScene joined(RhumbConnection connection) {
    RhumbJoinOptions options;
    RhumbScene scene;
    EXPECT(RHUMB_CODE_OK, rhumb_join_options_init(&options));
    options.coordinates = RHUMB_COORDINATES_Z_UP;
    options.refusals = RHUMB_REFUSALS_EVENTS;
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "fed", &options, &scene));
    return scene;
}

static RhumbScene owner_of(RhumbLocalServer server) {
    RhumbConnection connection;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_feed(server, "fed", 30, &connection));
    return joined(connection);
}

static RhumbScene follower_of(RhumbLocalServer server) {
    RhumbConnection connection;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_connect(server, 30, &connection));
    return joined(connection);
}

static bool shows(RhumbScene follower, RhumbBody body, const float *position) {
    RhumbPoses poses;
    size_t place;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll(follower, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poses(follower, &poses));
    if (rhumb_scene_place(follower, body, &place) != RHUMB_CODE_OK) return false;
    for (int axis = 0; axis < 3; axis++) {
        if (!(fabsf(poses.positions[3 * place + axis] - position[axis]) < 0.06f)) return false;
    }
    return true;
}

static void sees(RhumbScene follower, RhumbBody body, const float *position) {
    // A server with a thread of its own may not have stepped yet.
    for (int i = 0; i < 5000 && !shows(follower, body, position); i++) {
        EXPECT(RHUMB_CODE_OK, rhumb_scene_idle(follower, 0.001));
    }
    HOLDS(shows(follower, body, position));
}

static void add_balls(RhumbScene scene, RhumbBody *bodies, size_t count) {
    RhumbBodyDesc desc;
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    for (size_t i = 0; i < count; i++) EXPECT(RHUMB_CODE_OK, rhumb_scene_add_bodies(scene, &desc, 1, &bodies[i]));
}

static void followers_see_and_ask(void) {
    RhumbLocalServer server;
    RhumbBody bodies[3];
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    RhumbScene owner = owner_of(server), follower = follower_of(server);
    add_balls(owner, bodies, 2);
    float at[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9}, turns[12] = {0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1};
    RhumbFedStates states = {.count = 2, .bodies = bodies, .positions = at, .rotations = turns};
    uint64_t tick = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &states, &tick));
    HOLDS(tick == 1);
    sees(follower, bodies[0], at);
    sees(follower, bodies[1], at + 3);

    RhumbCommand commands[3] = {
        {.kind = RHUMB_COMMAND_KIND_IMPULSE_AT, .body = bodies[1], .vector = {1, 2, 3}, .point = {4, 5, 6}},
        {.kind = RHUMB_COMMAND_KIND_SET_POSE, .body = bodies[0], .vector = {7, 8, 9}, .rotation = {0, 0, 1, 0}},
        {.kind = RHUMB_COMMAND_KIND_SET_GRAVITY, .vector = {0, 0, -3}},
    };
    EXPECT(RHUMB_CODE_OK, rhumb_scene_command(follower, commands, 3, NULL));
    add_balls(follower, &bodies[2], 1);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll(follower, NULL));
    RhumbRequest push, pose, gravity, body, none;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &push));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &pose));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &gravity));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &body));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &none));
    HOLDS(push.kind == RHUMB_REQUEST_KIND_APPLY_IMPULSE && push.body == bodies[1] && push.has_point == 1);
    HOLDS(push.vector[1] == 2 && push.point[2] == 6 && push.client[0] == 0);
    HOLDS(pose.kind == RHUMB_REQUEST_KIND_SET_POSE && pose.position[0] == 7 && pose.rotation[2] == 1);
    HOLDS(gravity.kind == RHUMB_REQUEST_KIND_SET_GRAVITY && gravity.vector[2] == -3 && gravity.has_point == 0);
    HOLDS(body.kind == RHUMB_REQUEST_KIND_ADD_BODY && body.body == bodies[2]);
    HOLDS(none.kind == RHUMB_REQUEST_KIND_NONE && none.request == 0);

    EXPECT(RHUMB_CODE_OK, rhumb_scene_accept_request(owner, body.request));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_refuse_request(owner, gravity.request));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_accept_request(owner, gravity.request));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_refuse_request(owner, 0));
    states.count = 3;
    states.tick = 9;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &states, &tick));
    HOLDS(tick == 9);
    sees(follower, bodies[2], at + 6);
    RhumbEvent event;
    do {
        EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_event(follower, &event));
        HOLDS(event.kind != RHUMB_EVENT_KIND_NONE);
    } while (event.kind != RHUMB_EVENT_KIND_COMMAND_REFUSED);
    HOLDS(event.number == gravity.number);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(follower));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(owner));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

static void what_the_scene_refuses_is_an_error_of_the_next_feed(void) {
    RhumbLocalServer server;
    RhumbConnection connection;
    RhumbScene owner;
    RhumbBody ball, asked;
    RhumbRequest request;
    RhumbRefusal refusal;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_feed(server, "fed", 30, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "fed", NULL, &owner));
    add_balls(owner, &ball, 1);
    RhumbScene follower = follower_of(server);
    add_balls(follower, &asked, 1);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll(follower, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_request(owner, &request));
    HOLDS(request.kind == RHUMB_REQUEST_KIND_ADD_BODY && request.body == asked);
    // The member has left when its request is accepted.
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(follower));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_accept_request(owner, request.request));
    float at[3] = {1, 2, 3};
    RhumbFedStates states = {.count = 1, .bodies = &ball, .positions = at};
    uint64_t tick = 0;
    EXPECT(RHUMB_CODE_REFUSED, rhumb_scene_feed(owner, &states, &tick));
    HOLDS(tick == 1);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poll_refusal(owner, &refusal));
    HOLDS(refusal.exists == 1 && refusal.body == asked);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &states, &tick));
    HOLDS(tick == 2);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(owner));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

static void misuse_of_states(void) {
    RhumbLocalServer server;
    RhumbBody bodies[2];
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    RhumbScene owner = owner_of(server), follower = follower_of(server);
    add_balls(owner, bodies, 2);
    float at[6] = {0}, wrong[6] = {NAN}, far[6] = {0, 0, 0, 0, 2e5f, 0};
    const RhumbFedStates right = {.count = 2, .bodies = bodies, .positions = at, .linear_velocities = at};
    RhumbFedStates states = right;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_feed(owner, NULL, NULL));
    states.positions = NULL;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_feed(owner, &states, NULL));
    states = right;
    states.bodies = NULL;
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_feed(owner, &states, NULL));
    states = right;
    states.count = SIZE_MAX;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    states = right;
    states.rotations = wrong;
    states.count = 1;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    states = right;
    states.positions = wrong;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    states.positions = far;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    HOLDS(strstr(rhumb_last_error(), "200000 m") != NULL);
    states = right;
    states.tick = 601;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    RhumbBody twice[2] = {bodies[0], bodies[0]}, unknown[2] = {bodies[0], 0};
    states = right;
    states.bodies = twice;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    states.bodies = unknown;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(owner, &states, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_feed(follower, &right, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_advance(owner, 0, NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_poll_request(owner, NULL));
    // Nothing of all this was fed.
    uint64_t tick = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &right, &tick));
    HOLDS(tick == 1);
    states = (RhumbFedStates){0};
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &states, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(owner));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_feed(owner, &right, NULL));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_accept_request(owner, 1));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(follower));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

static void misuse_of_servers(void) {
    RhumbLocalServer none = {0}, server, served;
    RhumbConnection connection, other;
    RhumbScene scene;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_feed(server, NULL, 0, &connection));
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_feed(server, "fed", 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_feed(server, "a b", 0, &connection));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_feed(server, "fed", -1, &connection));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_local_server_feed(none, "fed", 0, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_feed(server, "fed", 0, &connection));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_feed(server, "fed", 0, &other));
    EXPECT(RHUMB_CODE_INVALID, rhumb_join(connection, "other", NULL, &scene));
    EXPECT(RHUMB_CODE_OK, rhumb_connection_close(connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
    EXPECT(RHUMB_CODE_OK, rhumb_serve(NULL, 0, &served));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_feed(served, "fed", 0, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(served));
    EXPECT(RHUMB_CODE_NULL, rhumb_serve_fed(NULL, NULL, 0, &served));
    EXPECT(RHUMB_CODE_NULL, rhumb_serve_fed("fed", NULL, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_serve_fed("fed", "nowhere", 0, &served));
    EXPECT(RHUMB_CODE_INVALID, rhumb_serve_fed("fed", NULL, 2, &served));
}

static void others_follow_a_served_scene(void) {
    RhumbLocalServer server;
    RhumbAddress address;
    RhumbConnection connection;
    RhumbBody ball;
    EXPECT(RHUMB_CODE_OK, rhumb_serve_fed("fed", NULL, 0, &server));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_address(server, &address));
    RhumbScene owner = owner_of(server);
    add_balls(owner, &ball, 1);
    float at[3] = {1, 2, 3};
    RhumbFedStates states = {.count = 1, .bodies = &ball, .positions = at};
    EXPECT(RHUMB_CODE_OK, rhumb_scene_feed(owner, &states, NULL));
    RhumbConnectOptions how = {.address = address.text};
    EXPECT(RHUMB_CODE_OK, rhumb_connect(&how, &connection));
    RhumbScene follower = joined(connection);
    sees(follower, ball, at);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(follower));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(owner));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

int main(void) {
    followers_see_and_ask();
    what_the_scene_refuses_is_an_error_of_the_next_feed();
    misuse_of_states();
    misuse_of_servers();
    others_follow_a_served_scene();
    printf("the followers saw what was fed\n");
    return 0;
}
