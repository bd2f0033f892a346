// A server in the process, in C++.
//
// Its members see each other's bodies, and stay when its handle is gone.

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <cstdlib>
#include <utility>

#include "rhumb.hpp"

static void expect(bool holds, const char* what) {
    if (!holds) {
        std::fprintf(stderr, "does not hold: %s\n", what);
        std::exit(1);
    }
}

static void others_join() {
    auto server = rhumb::LocalServer::serve();
    auto own = server.connect().join("shared");
    auto other = rhumb::Connection::connect(server.address(), rhumb::Trust::by_address()).join("shared");
    auto ball = own.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)).at(0, 10, 0));
    own.advance();
    for (int i = 0; i < 10 && !other.place(ball); ++i) other.advance();
    expect(other.place(ball).has_value(), "a client of the network sees the ball");
    expect(rhumb::LocalServer().address().empty(), "a server without sockets has no address");
    try {
        rhumb::LocalServer::serve("0.0.0.0:0");
        expect(false, "an address of other machines is refused");
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_INVALID, error.what());
    }
    try {
        other.page();
        expect(false, "the page of a server elsewhere is not known");
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_DENIED, error.what());
    }
}

static void a_robot_is_loaded() {
    const auto path = std::filesystem::temp_directory_path() / ("rhumb-" + std::to_string(std::rand()) + ".urdf");
    std::ofstream(path) << "<robot name='arm'><link name='world'/><link name='arm'><inertial><mass value='2'/>"
                           "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
                           "<joint name='hinge' type='continuous'><parent link='world'/><child link='arm'/>"
                           "<mimic joint='other'/></joint></robot>";
    auto scene = rhumb::Connection::local().join("robots");
    rhumb::LoadOptions options;
    options.position = {0, 3, 0};
    options.first_joint = 7;
    auto robot = scene.load(path.string(), options);
    std::filesystem::remove(path);
    scene.advance();
    expect(robot.bodies.count("arm") == 1 && robot.joints.at("hinge") == 7, "names are those of the file");
    expect(robot.frames.at("arm").rotation.w > 0.99f && !robot.left_out.empty(), "frames and notes");
    expect(scene.poses().positions()[scene.place(robot.bodies.at("arm")).value()].y > 2.9f, "the place of the file");
    try {
        scene.load("nothing.urdf");
        expect(false, "a missing file is refused");
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_INVALID, error.what());
    }
}

static void a_fork_runs_alike() {
    rhumb::LocalServer server;
    auto scene = server.connect().join("one");
    auto ball = scene.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)).at(0, 10, 0));
    for (int i = 0; i < 10; ++i) scene.advance();
    auto saved = rhumb::Checkpoint::read(scene.save().bytes());
    server.restore("two", saved);
    server.restore("three", saved);
    auto two = server.connect().join("two");
    auto three = server.connect().join("three");
    for (int i = 0; i < 60; ++i) {
        two.advance();
        three.advance();
    }
    expect(two.save().bytes() == three.save().bytes(), "two scenes of one checkpoint are equal to the bit");
    expect(two.place(ball).has_value(), "the id stays");
    for (int i = 0; i < 60; ++i) scene.advance();
    expect(scene.save().bytes() == two.save().bytes(), "the saved scene runs as they do");
    auto bytes = saved.bytes();
    bytes[bytes.size() / 2] ^= 1;
    try {
        rhumb::Checkpoint::read(bytes);
        expect(false, "a flipped bit is refused");
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_INVALID, error.what());
    }
}

int main() {
    for (auto thread : {rhumb::LocalThread::Callers, rhumb::LocalThread::Own}) {
        rhumb::LocalServer server(thread);
        rhumb::LocalServer moved(std::move(server));
        auto one = moved.connect().join("shared");
        auto other = moved.connect(30).join("shared");
        auto ball = one.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)).at(0, 10, 0));
        moved.close();
        moved.close();
        one.advance();
        for (int i = 0; i < 10 && !other.place(ball); ++i) other.advance();
        expect(other.place(ball).has_value(), "the other member sees the ball");
        try {
            moved.connect();
            expect(false, "a closed server refuses");
        } catch (const rhumb::Error& error) {
            expect(error.code() == RHUMB_CODE_CLOSED, error.what());
        }
    }
    others_join();
    a_robot_is_loaded();
    a_fork_runs_alike();
    auto connection = rhumb::Connection::local();
    expect(connection.join("drop").advance() == 1, "a scene on a server of its own");
    std::printf("the members saw the ball\n");
}
