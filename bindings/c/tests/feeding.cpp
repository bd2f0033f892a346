// A scene that the program feeds, in C++: what followers see and ask.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "rhumb.hpp"

static void expect(bool holds, const char* what) {
    if (!holds) {
        std::fprintf(stderr, "does not hold: %s\n", what);
        std::exit(1);
    }
}

template <typename Call>
static void expect_invalid(Call call, const char* what) {
    try {
        call();
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_INVALID, error.what());
        return;
    }
    expect(false, what);
}

static bool shows(rhumb::Scene& follower, rhumb::Body body, rhumb::Vec3 position) {
    follower.poll();
    const auto place = follower.place(body);
    if (!place) {
        return false;
    }
    const auto at = follower.poses().positions()[*place];
    return std::fabs(at.x - position.x) < 0.06F && std::fabs(at.y - position.y) < 0.06F && std::fabs(at.z - position.z) < 0.06F;
}

static void sees(rhumb::Scene& follower, rhumb::Body body, rhumb::Vec3 position) {
    // A server with a thread of its own may not have stepped yet.
    for (int i = 0; i < 5000 && !shows(follower, body, position); ++i) {
        follower.idle(0.001);
    }
    expect(shows(follower, body, position), "the follower sees what is fed");
}

static void followers_see_and_ask() {
    rhumb::LocalServer server;
    auto owner = server.feed("fed").join("fed");
    auto ball = owner.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)));
    rhumb::FedStates states;
    states.bodies = {ball};
    states.positions = {{0, 10, 0}};
    states.rotations = {{0, 0, 0, 1}};
    states.linear_velocities = {{1, 0, 0}};
    expect(owner.feed(states) == 1, "ticks begin at one");
    auto follower = server.connect().join("fed", rhumb::JoinOptions().with_refusals(RHUMB_REFUSALS_EVENTS));
    follower.command(rhumb::command::impulse(ball, {1, 2, 3}));
    const auto number = follower.command(rhumb::command::set_gravity({0, -3, 0}));
    follower.poll();
    const auto push = owner.poll_request(), gravity = owner.poll_request();
    expect(push.has_value() && push->kind == RHUMB_REQUEST_KIND_APPLY_IMPULSE && push->vector[2] == 3, "a push");
    expect(gravity.has_value() && gravity->number == number, "another gravity");
    expect(!owner.poll_request().has_value(), "there is no further request");
    owner.accept(*push);
    owner.refuse(*gravity);
    expect_invalid([&] { owner.refuse(*gravity); }, "an answer twice");
    states.positions = {{5, 6, 7}};
    states.tick = 4;
    expect(owner.feed(states) == 4, "the tick that was given");
    sees(follower, ball, {5, 6, 7});
    states.tick = 0;
    expect_invalid([&] { owner.feed(states); }, "no state is of tick 0");
    states.tick.reset();
    states.positions.clear();
    expect_invalid([&] { owner.feed(states); }, "each body has a row");
    expect_invalid([&] { follower.feed(rhumb::FedStates()); }, "a follower feeds nothing");
    expect(owner.feed(rhumb::FedStates()) == 5, "no body is fed");
}

static void others_follow_a_served_scene() {
    auto server = rhumb::LocalServer::serve_fed("fed");
    auto owner = server.feed("fed").join("fed");
    auto ball = owner.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)));
    rhumb::FedStates states;
    states.bodies = {ball};
    states.positions = {{1, 2, 3}};
    owner.feed(states);
    auto follower = rhumb::Connection::connect(server.address(), rhumb::Trust::by_address()).join("fed");
    sees(follower, ball, {1, 2, 3});
    expect_invalid([] { rhumb::LocalServer::serve().feed("fed"); }, "a server with engines of its own is fed nothing");
}

int main() {
    followers_see_and_ask();
    others_follow_a_served_scene();
    std::printf("the followers saw what was fed\n");
}
