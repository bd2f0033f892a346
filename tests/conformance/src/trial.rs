//! One run of a case: the peer under test, its connections, its log.
//!
//! Lives on one thread. Scenes that its clients created are deleted at the end.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;
use std::time::Duration;

use rhumb_netsim::{Carrier, Probability, RawConnection, RawPeerConfig, UdpRelay};
use rhumb_protocol::scene::SceneName;
use rhumb_transport::{Fingerprint, Trust};

use super::conditions::{Conditions, Subject};
use super::log::Log;
use super::outcome::{CaseOutcome, CaseResult, Closing, Stop, Verdict};
use super::peer::{Decoder, Interceptor, LossyClient, RawClient, RawServer, Setting};
use crate::seed::Dice;

/// One run of a case.
#[derive(Debug)]
pub struct Trial<'a> {
    /// The peer under test and the limits of the run.
    pub conditions: &'a Conditions,
    /// Its id.
    case: &'a str,
    log: Log,
    closing: Rc<RefCell<Closing>>,
    scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    named: u32,
    lines: u64,
}

impl<'a> Trial<'a> {
    /// Plays the case of an id.
    #[must_use]
    pub fn run(
        conditions: &'a Conditions,
        case: &'a str,
        play: impl FnOnce(&mut Self) -> CaseResult,
    ) -> CaseOutcome {
        let clock = rhumb_transport::Clock::start();
        let mut trial = Self {
            conditions,
            case,
            log: Log::default(),
            closing: Rc::new(RefCell::new(Closing::NotJudged)),
            scenes: Rc::default(),
            named: 0,
            lines: 0,
        };
        let played = catch_unwind(AssertUnwindSafe(|| play(&mut trial)));
        let play = played.unwrap_or_else(|_| Err(Stop::Inconclusive("the suite panicked".into())));
        let took = Duration::from_nanos(clock.now().as_nanos());
        trial.clear();
        let closing = trial.closing.borrow().clone();
        let (verdict, why) = match &play {
            Ok(()) => (Verdict::Pass, String::new()),
            Err(stop) => (stop.verdict(), stop.why().to_owned()),
        };
        let good = play.is_ok() && closing.is_good();
        let trace = if good { Vec::new() } else { trial.log.take() };
        CaseOutcome {
            verdict,
            why,
            closing,
            took,
            trace,
        }
    }

    /// The case's id.
    #[must_use]
    pub fn id(&self) -> &str {
        self.case
    }

    /// The random numbers of the case, reproducible from the seed.
    #[must_use]
    pub fn dice(&self) -> Dice {
        let id = self.case.bytes();
        let fold = |seed: u64, byte: u8| seed.wrapping_mul(0x100_0000_01b3) ^ u64::from(byte);
        Dice::new(id.fold(self.conditions.seed, fold))
    }

    /// Adds a line to the log.
    pub fn note(&self, line: impl Into<String>) {
        self.log.note(line);
    }

    /// The log of sent and received data.
    pub(super) fn log(&self) -> Log {
        self.log.clone()
    }

    /// Default time limit of every wait.
    #[must_use]
    pub const fn timeout(&self) -> Duration {
        self.conditions.timeout
    }

    /// The time that this many round trips take over the simulated network, half of it for what is lost on the way.
    #[must_use]
    pub fn round_trips(&self, count: u64) -> Duration {
        let link = &self.conditions.link;
        let one = 4 * (link.delay.as_nanos() + link.jitter.as_nanos());
        Duration::from_nanos(one.saturating_mul(count))
    }

    /// The name of a scene that no other case uses.
    ///
    /// # Panics
    ///
    /// Never: all parts of it are valid in a name.
    #[must_use]
    pub fn scene(&mut self) -> SceneName {
        self.named += 1;
        let (seed, id, number) = (self.conditions.seed, self.case, self.named);
        let process = std::process::id();
        format!("conformance/{process:x}-{seed:x}/{id}/{number}")
            .parse()
            .expect("a valid scene name")
    }

    /// A connection with an open control stream, about a new scene. Nothing is sent yet.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the server refuses the connection.
    pub fn client(&mut self) -> Result<RawClient, Stop> {
        let scene = self.scene();
        self.client_of(&scene)
    }

    /// The same for the scene of this name.
    ///
    /// # Errors
    ///
    /// As [`Self::client`].
    pub fn client_of(&mut self, scene: &SceneName) -> Result<RawClient, Stop> {
        let client = self.bare_client(scene, &RawPeerConfig::default())?;
        client.connection.open_control();
        Ok(client)
    }

    /// The same with this configuration, and without a control stream.
    ///
    /// # Errors
    ///
    /// As [`Self::client`].
    pub fn bare_client(
        &mut self,
        scene: &SceneName,
        config: &RawPeerConfig,
    ) -> Result<RawClient, Stop> {
        let (connection, relay) = self.connect(config)?;
        let mut client = RawClient::new(
            connection,
            relay,
            scene.clone(),
            self.timeout(),
            self.log.clone(),
            Rc::clone(&self.closing),
            Rc::clone(&self.scenes),
        );
        client.token = self.conditions.token.clone();
        Ok(client)
    }

    /// A client with a session and a replica, which is not yet a member.
    ///
    /// # Errors
    ///
    /// As [`Self::client`].
    pub fn subscriber(&mut self) -> Result<LossyClient, Stop> {
        let scene = self.scene();
        self.subscriber_of(&scene)
    }

    /// The same for the scene of this name.
    ///
    /// # Errors
    ///
    /// As [`Self::client`].
    pub fn subscriber_of(&mut self, scene: &SceneName) -> Result<LossyClient, Stop> {
        Ok(LossyClient::new(self.client_of(scene)?))
    }

    /// A raw server, with the client under test connected to it.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the client cannot be started; [`Stop::Unsupported`] when it declares so.
    pub fn raw_server(&mut self) -> Result<RawServer, Stop> {
        self.raw_server_for("subscribe 10000")
    }

    /// The same; the client performs this task after `Welcome`. `docs/book/src/implementing.md` lists the tasks.
    ///
    /// # Errors
    ///
    /// As [`Self::raw_server`].
    pub fn raw_server_for(&mut self, task: &str) -> Result<RawServer, Stop> {
        self.raw_server_pinned(task, None)
    }

    /// The same; the client is given this fingerprint instead of the server's.
    ///
    /// # Errors
    ///
    /// As [`Self::raw_server`]; [`Stop::Fail`] when the client keeps no connection.
    pub fn raw_server_pinned(
        &mut self,
        task: &str,
        pinned: Option<Fingerprint>,
    ) -> Result<RawServer, Stop> {
        self.raw_server_over(self.conditions, task, pinned)
    }

    fn raw_server_over(
        &self,
        conditions: &Conditions,
        task: &str,
        pinned: Option<Fingerprint>,
    ) -> Result<RawServer, Stop> {
        RawServer::start(
            conditions,
            self.case,
            task,
            pinned,
            self.log.clone(),
            Rc::clone(&self.closing),
        )
    }

    /// A real server in this process with a scripted scene, and the client under test connected to it.
    ///
    /// # Errors
    ///
    /// As [`Self::raw_server`].
    pub fn interceptor(&mut self, setting: Setting) -> Result<Interceptor, Stop> {
        let raw_server = self.raw_server_for(&setting.task)?;
        Interceptor::begin(raw_server, &format!("conformance/{}", self.case), &setting)
    }

    /// The same over a link that loses nothing, however it is configured: for a case that decides itself which
    /// datagrams are lost, and keeps refreshes back.
    ///
    /// # Errors
    ///
    /// As [`Self::raw_server`].
    pub fn lossless_interceptor(&mut self, setting: Setting) -> Result<Interceptor, Stop> {
        let mut conditions = self.conditions.clone();
        conditions.link = conditions.link.with_loss(Probability::NONE);
        conditions.link.rate_bytes = None;
        let raw_server = self.raw_server_over(&conditions, &setting.task, None)?;
        Interceptor::begin(raw_server, &format!("conformance/{}", self.case), &setting)
    }

    /// The decoder under test.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when it cannot be started.
    pub fn decoder(&mut self) -> Result<Decoder, Stop> {
        let Subject::Decoder { ref exec } = self.conditions.subject else {
            return Err(Stop::Inconclusive("this case is for a decoder".into()));
        };
        Decoder::start(exec.as_deref(), self.timeout() * 10, self.log.clone())
    }

    /// Address of the server under test for the client under test: that of the relay, if there is one.
    pub(super) fn behind_the_link(
        &mut self,
    ) -> Result<(std::net::SocketAddr, Option<UdpRelay>), Stop> {
        let (target, _, _) = self.server()?;
        let relay = self.relay(target)?;
        let address = relay.as_ref().map_or(target, UdpRelay::local_addr);
        Ok((address, relay))
    }

    /// The server under test.
    fn server(&self) -> Result<(std::net::SocketAddr, &'a str, &'a Trust), Stop> {
        match &self.conditions.subject {
            Subject::Server {
                target,
                name,
                trust,
            }
            | Subject::Pair {
                target,
                name,
                trust,
                ..
            } => Ok((*target, name, trust)),
            _ => Err(Stop::Inconclusive("this case is for a server".into())),
        }
    }

    fn connect(
        &mut self,
        config: &RawPeerConfig,
    ) -> Result<(RawConnection, Option<UdpRelay>), Stop> {
        let (target, name, trust) = self.server()?;
        // The suite's own member of a pair's scene does not use the simulated network.
        let relay = match self.conditions.subject {
            Subject::Pair { .. } => None,
            _ => self.relay(target)?,
        };
        let address = relay.as_ref().map_or(target, UdpRelay::local_addr);
        let time_limit = self.timeout() * 2;
        let config = match self.conditions.carrier {
            Carrier::Quic => config.clone(),
            carrier @ Carrier::WebTransport => RawPeerConfig {
                carrier,
                alpn: RawPeerConfig::over(carrier).alpn,
                ..config.clone()
            },
        };
        let connection = RawConnection::connect(address, name, trust, &config, time_limit);
        let connection =
            connection.map_err(|error| Stop::Fail(format!("no connection: {error}")))?;
        Ok((connection, relay))
    }

    /// The relay with the simulated network, if one is configured.
    fn relay(&mut self, target: std::net::SocketAddr) -> Result<Option<UdpRelay>, Stop> {
        self.lines += 1;
        self.conditions.relay(target, self.lines)
    }

    /// Connects with this configuration and returns the end of the connection.
    ///
    /// # Errors
    ///
    /// The end of the connection.
    pub fn try_connect(
        &mut self,
        config: &RawPeerConfig,
    ) -> Result<(RawConnection, Option<UdpRelay>), Stop> {
        self.connect(config)
    }

    /// Deletes the remaining scenes.
    fn clear(&mut self) {
        let left: Vec<_> = self.scenes.borrow().iter().cloned().collect();
        for scene in left {
            let deleted = self.client_of(&scene).and_then(|mut client| {
                client.hello()?;
                client.delete()
            });
            if let Err(stop) = deleted {
                self.log
                    .note(format!("{scene} is not deleted: {}", stop.why()));
            }
        }
    }
}
