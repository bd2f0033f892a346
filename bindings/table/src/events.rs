//! The events that bindings report.
//!
//! They are those of the protocol, and those of a client itself.

/// An event: its name in words, and what it says.
#[derive(Clone, Copy, Debug)]
pub struct Reported {
    /// In small letters.
    pub name: &'static str,
    /// A sentence, in which fields of the event have accents.
    pub doc: &'static str,
}

const fn reported(name: &'static str, doc: &'static str) -> Reported {
    Reported { name, doc }
}

/// All of them, in the order of their numbers.
pub const EVENTS: [Reported; 30] = [
    reported(
        "commands applied",
        "All commands up to `number` were applied or refused; they act in the step after `tick`.",
    ),
    reported(
        "command refused",
        "The command `number` was refused; `text` says why, and `body` is one that the reason names.",
    ),
    reported(
        "body placed",
        "`body` was placed in the scene, or its description was replaced.",
    ),
    reported("body removed", "`body` was removed; `text` says why."),
    reported("contact began", "`body` and `other` began to touch."),
    reported(
        "contact ended",
        "`body` and `other` ceased to touch, or one of them was removed.",
    ),
    reported(
        "contact force",
        "The force between `body` and `other` reached the threshold of one of them.",
    ),
    reported("sensor entered", "`other` entered the sensor `body`."),
    reported("sensor left", "`other` left the sensor `body`."),
    reported("fell asleep", "`body` fell asleep."),
    reported("woke", "`body` woke."),
    reported(
        "body fault",
        "The state of `body` was not finite, and it was removed.",
    ),
    reported(
        "reached ground",
        "The character `body` reached ground that carries it.",
    ),
    reported(
        "left ground",
        "No ground carries the character `body` any more.",
    ),
    reported(
        "events missed",
        "So many events of bodies as `number` says were not kept.",
    ),
    reported(
        "stream changed",
        "The stream changed, by request or because of the link.",
    ),
    reported(
        "publisher silent",
        "The server receives nothing from the member with authority over `body`: from `tick` on its pose is a guess, and its error bound is infinite.",
    ),
    reported(
        "publisher active",
        "It receives from that member again, or its authority has ended: from `tick` on `body` has an error bound.",
    ),
    reported(
        "scene restored",
        "The engine failed, and the scene continues from `tick` without the commands that it failed on.",
    ),
    reported(
        "scene faulted",
        "The engine failed, and the scene stands still after `tick`.",
    ),
    reported("scene deleted", "The scene was deleted."),
    reported(
        "interrupted",
        "The connection ended, and the client tries to resume.",
    ),
    reported(
        "resumed",
        "The client continues with its session over another connection.",
    ),
    reported(
        "session lost",
        "The server does not know the session any more.",
    ),
    reported(
        "durable",
        "The scene up to `tick` survives a crash of the server.",
    ),
    reported(
        "authority granted",
        "The server granted authority over as many bodies as `number` says.",
    ),
    reported(
        "authority denied",
        "The server denied authority; `text` says why, and `body` is one that the reason names.",
    ),
    reported("denied", "The server denied a request; `text` says why."),
    reported("ended", "The connection ended; `text` says why."),
    reported(
        "other",
        "An event that bindings do not describe further; `text` names it.",
    ),
];
