//! Joins a scene on a thread of its own, so that no frame waits for a server.

use std::error::Error;
use std::io;
use std::thread::{Builder, JoinHandle};

use bevy_ecs::message::MessageWriter;
use bevy_ecs::resource::Resource;
use bevy_ecs::system::{Commands, ResMut};
use rhumb_client::Client;

use crate::client::RhumbClient;
use crate::messages::RhumbJoinFailed;

/// A client on its way into a scene.
///
/// Insert it as a resource. The plug-in replaces it by a [`RhumbClient`], or writes [`RhumbJoinFailed`].
#[derive(Debug, Resource)]
pub struct RhumbJoin {
    /// `None` once its client is taken over.
    thread: Option<JoinHandle<Result<Client, Box<dyn Error + Send + Sync>>>>,
}

impl RhumbJoin {
    /// Calls `join` on a thread of its own. It connects, joins, and may furnish the scene.
    ///
    /// # Errors
    ///
    /// The system starts no thread.
    pub fn start(
        join: impl FnOnce() -> Result<Client, Box<dyn Error + Send + Sync>> + Send + 'static,
    ) -> io::Result<Self> {
        let thread = Builder::new().name("rhumb-bevy-join".to_owned());
        Ok(Self {
            thread: Some(thread.spawn(join)?),
        })
    }
}

/// Takes over the client of a thread that has ended.
pub(crate) fn finish_join(
    mut join: ResMut<'_, RhumbJoin>,
    mut commands: Commands<'_, '_>,
    mut failures: MessageWriter<'_, RhumbJoinFailed>,
) {
    let Some(thread) = join.thread.take_if(|thread| thread.is_finished()) else {
        return;
    };
    commands.remove_resource::<RhumbJoin>();
    match thread.join() {
        Ok(Ok(client)) => commands.insert_resource(RhumbClient::new(client)),
        Ok(Err(error)) => {
            failures.write(RhumbJoinFailed { error });
        }
        Err(_) => {
            let error = "the function that was to join the scene panicked; its message is on standard error".into();
            failures.write(RhumbJoinFailed { error });
        }
    }
}
