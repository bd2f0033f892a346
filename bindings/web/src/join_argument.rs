//! The request of a member that joins, out of JSON.

use core::num::NonZeroU32;

use rhumb_protocol::message::{SessionKey, StreamChoice, TierPolicy};
use rhumb_protocol::scene::{PublishSchedule, SceneConfig, Stepping};
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{
    Integrator, LengthBound, Metres, Radians, Rate, Ticks, Tolerance, TurnBound,
};
use rhumb_view::{InvalidTicks, JoinMode, ViewOptions};

use crate::argument::Argument;
use crate::failure::Failure;
use crate::scene_argument::{damping, material, sleep};

/// Options of a join.
#[derive(Debug)]
pub(crate) struct JoinArguments {
    pub(crate) mode: JoinMode,
    pub(crate) stream: StreamChoice,
    pub(crate) view: ViewOptions,
    pub(crate) lead_ticks: f64,
}

impl JoinArguments {
    pub(crate) fn read(from: &Argument<'_>) -> Result<Self, Failure> {
        let number = |field| {
            let number = from.optional(field).map(|field| field.number());
            Ok::<_, Failure>(number.transpose()?.unwrap_or_default())
        };
        let ticks = |field| {
            let (ticks, given) = (number(field)?, from.optional(field));
            match (InvalidTicks::check_delay(ticks), given) {
                (Err(_), Some(given)) => Err(given.wrong("0 to 3600 ticks")),
                _ => Ok(ticks),
            }
        };
        let flag = |field| from.optional(field).map(|field| field.flag()).transpose();
        Ok(Self {
            mode: mode(from.optional("mode"))?,
            stream: match from.optional("stream") {
                None => StreamChoice::Within(Tolerance::NORMAL),
                Some(from) => stream(&from)?,
            },
            view: ViewOptions {
                delay_ticks: ticks("delayTicks")?,
                whole_ticks: flag("wholeTicks")?.unwrap_or_default(),
                smooth: flag("smooth")?.unwrap_or(true),
            },
            lead_ticks: ticks("leadTicks")?,
        })
    }
}

fn mode(from: Option<Argument<'_>>) -> Result<JoinMode, Failure> {
    let Some(from) = from else {
        return Ok(JoinMode::Join);
    };
    if from.as_text() == Some("join") {
        return Ok(JoinMode::Join);
    }
    if let Some(config) = from.optional("create") {
        return Ok(JoinMode::Create(scene_config(&config)?));
    }
    match from.optional("createOrJoin") {
        Some(config) => Ok(JoinMode::CreateOrJoin(scene_config(&config)?)),
        None => Err(from.wrong("\"join\", or an object with create or createOrJoin")),
    }
}

fn scene_config(from: &Argument<'_>) -> Result<SceneConfig, Failure> {
    let mut config = SceneConfig::default();
    if let Some(from) = from.optional("stepping") {
        config.stepping = match from.text()? {
            "lockstep" => Stepping::Lockstep,
            "freeRunning" => Stepping::FreeRunning,
            _ => return Err(from.wrong("lockstep or freeRunning")),
        };
    }
    if let Some(from) = from.optional("rate") {
        let (ticks, seconds) = (from.field("ticks")?.u32()?, from.field("seconds")?.u32()?);
        let rate = Rate::new(ticks, seconds);
        config.integrator = Integrator {
            rate: rate.ok_or_else(|| from.wrong("ticks and seconds, neither of them 0"))?,
            ..config.integrator
        };
    }
    let count = |from: &Argument<'_>| {
        let count = NonZeroU32::new(from.u32()?);
        count.ok_or_else(|| from.wrong("a whole number that is not 0"))
    };
    if let Some(from) = from.optional("substeps") {
        config.integrator.substeps = count(&from)?;
    }
    if let Some(from) = from.optional("gravity") {
        config.gravity = from.vector()?;
    }
    if let Some(from) = from.optional("material") {
        config.material = material(&from)?;
    }
    if let Some(from) = from.optional("damping") {
        config.damping = damping(&from)?;
    }
    if let Some(from) = from.optional("sleep") {
        config.sleep = sleep(&from)?;
    }
    let mut schedule = PublishSchedule::EACH_TICK;
    if let Some(from) = from.optional("publishInterval") {
        schedule.publish_interval = count(&from)?;
    }
    if let Some(from) = from.optional("lookahead") {
        schedule.lookahead = Ticks::new(from.u32()?);
    }
    config.publish_schedule = schedule;
    config.check().map_err(|why| from.refused(why))?;
    Ok(config)
}

pub(crate) fn stream(from: &Argument<'_>) -> Result<StreamChoice, Failure> {
    if from.as_text() == Some("full") {
        return Ok(StreamChoice::Full);
    }
    let tolerance = tolerance(&from.field("within")?)?;
    let Some(from) = from.optional("budget") else {
        return Ok(StreamChoice::Within(tolerance));
    };
    let budget = match from.as_number() {
        Some(_) => Budget::per_second(from.u32()?),
        None => Budget::new(
            from.field("bytesPerSecond")?.u32()?,
            from.field("burst")?.u32()?,
        ),
    };
    Ok(StreamChoice::Capped {
        tolerance,
        budget: budget.ok_or_else(|| from.wrong("a budget within the protocol's limits"))?,
    })
}

pub(crate) fn tolerance(from: &Argument<'_>) -> Result<Tolerance, Failure> {
    if from.as_number().is_some() {
        return Ok(Tolerance::Surface(length(from)?));
    }
    let turn = from.field("turn")?;
    let radians = Radians::new(turn.number()?);
    Ok(Tolerance::Parts {
        position: length(&from.field("position")?)?,
        turn: TurnBound::from_radians(radians).map_err(|why| turn.refused(why))?,
    })
}

fn length(from: &Argument<'_>) -> Result<LengthBound, Failure> {
    let metres = Metres::new(from.number()?);
    LengthBound::from_metres(metres).map_err(|why| from.refused(why))
}

pub(crate) fn tier_policy(from: &Argument<'_>) -> Result<TierPolicy, Failure> {
    match from.as_text() {
        Some("never") => Ok(TierPolicy::Never),
        _ => Ok(TierPolicy::UpTo(length(&from.field("upTo")?)?)),
    }
}

/// The key of a session, out of 32 hexadecimal digits.
pub(crate) fn session_key(from: &Argument<'_>) -> Result<SessionKey, Failure> {
    let digits = from.text()?;
    let mut key = [0; 16];
    let wrong = || from.wrong("32 hexadecimal digits");
    if digits.len() != 32 || !digits.is_ascii() {
        return Err(wrong());
    }
    for (byte, at) in key.iter_mut().zip((0..32).step_by(2)) {
        *byte = u8::from_str_radix(&digits[at..at + 2], 16).map_err(|_| wrong())?;
    }
    Ok(SessionKey(key))
}
