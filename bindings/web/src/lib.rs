//! The client of a remote scene as functions of a WebAssembly module.
//!
//! No pointer of the caller is dereferenced. Bytes and JSON go in through a buffer of this module ([`input`]) and come out
//! through another ([`output`]); columns of numbers are read in place. A member is named by a number. Functions that can
//! fail return 0 and leave an error as JSON in the output. Moments are milliseconds of one clock of the caller.

mod argument;
mod generated;
mod member;
mod scene_argument;
mod scene_json;

use std::cell::RefCell;

use glam::{Quat, Vec3};
use rhumb_protocol::{Ending, Instant, Transmit};
use rhumb_reckoning::Tick;
use rhumb_view::{InvalidTicks, RenderTime};
use serde_json::{Value, json};

use crate::argument::{Argument, AskedFields, Failure, body_of, id_number};
use crate::member::Columns;
use crate::member::{MemberOptions, WebMember};
use crate::scene_argument::CellArguments;

// JavaScript reads these as plain numbers in a row.
const _: () = assert!(size_of::<Vec3>() == 12 && size_of::<Quat>() == 16);

thread_local! {
    static MEMBERS: RefCell<Vec<Option<WebMember>>> = const { RefCell::new(Vec::new()) };
    static INPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static OUTPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Makes room for so many bytes of input, and returns their place. The next call that takes input reads them.
#[unsafe(no_mangle)]
pub extern "C" fn input(bytes: u32) -> *const u8 {
    INPUT.with_borrow_mut(|input| {
        input.clear();
        input.resize(bytes as usize, 0);
        input.as_ptr()
    })
}

/// Place of the last output.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    OUTPUT.with_borrow(Vec::as_ptr)
}

/// Bytes of the last output.
#[unsafe(no_mangle)]
pub extern "C" fn output_bytes() -> u32 {
    OUTPUT.with_borrow(|output| output.len() as u32)
}

/// A member of the options in the input; 0 if they cannot be used.
#[unsafe(no_mangle)]
pub extern "C" fn member_new() -> u32 {
    let options = read("options", MemberOptions::read);
    match options {
        Ok(options) => MEMBERS.with_borrow_mut(|members| {
            let member = Some(WebMember::new(options));
            match members.iter().position(Option::is_none) {
                Some(free) => {
                    members[free] = member;
                    free as u32 + 1
                }
                None => {
                    members.push(member);
                    members.len() as u32
                }
            }
        }),
        Err(failure) => fail(&failure),
    }
}

/// Forgets a member.
#[unsafe(no_mangle)]
pub extern "C" fn member_free(member: u32) {
    MEMBERS.with_borrow_mut(|members| {
        if let Some(slot) = slot(members, member) {
            *slot = None;
        }
    });
}

/// The connection is open.
#[unsafe(no_mangle)]
pub extern "C" fn handle_opened(member: u32, now: f64) {
    with_at(member, now, WebMember::handle_opened);
}

/// The input is the next bytes of the control stream.
#[unsafe(no_mangle)]
pub extern "C" fn handle_control(member: u32, now: f64) {
    INPUT.with_borrow(|bytes| {
        with_at(member, now, |member, now| member.handle_control(now, bytes));
    });
}

/// The input is a datagram.
#[unsafe(no_mangle)]
pub extern "C" fn handle_datagram(member: u32, now: f64) {
    INPUT.with_borrow(|bytes| {
        with_at(member, now, |member, now| {
            member.handle_datagram(now, bytes);
        });
    });
}

/// A moment that [`poll_timeout`] named has come.
#[unsafe(no_mangle)]
pub extern "C" fn handle_timeout(member: u32, now: f64) {
    with_at(member, now, WebMember::handle_timeout);
}

/// The connection has ended: closed by the server with a code, or broken if the code is negative.
#[unsafe(no_mangle)]
pub extern "C" fn handle_ended(member: u32, now: f64, code: f64) {
    let ending = match code < 0.0 {
        true => Ending::Broken,
        false => Ending::Closed(code as u32),
    };
    with_at(member, now, |member, now| member.handle_ended(now, ending));
}

/// The next transmission: 0 none, 1 control bytes, 2 a datagram, 3 close, with the code as JSON.
#[unsafe(no_mangle)]
pub extern "C" fn poll_transmit(member: u32) -> u32 {
    match with(member, WebMember::poll_transmit).flatten() {
        None => 0,
        Some(Transmit::Control { bytes, .. }) => {
            put(&bytes);
            1
        }
        Some(Transmit::State { bytes, .. }) => {
            put(&bytes);
            2
        }
        Some(Transmit::Close { code, .. }) => {
            put(json!(code).to_string().as_bytes());
            3
        }
    }
}

/// The moment of the next [`handle_timeout`]; negative if there is none.
#[unsafe(no_mangle)]
pub extern "C" fn poll_timeout(member: u32) -> f64 {
    let at = with(member, |member| member.poll_timeout()).flatten();
    at.map_or(-1.0, |at| at.as_nanos() as f64 / 1e6)
}

/// All new events as a list; 0 if there is none.
#[unsafe(no_mangle)]
pub extern "C" fn poll_events(member: u32) -> u32 {
    found(with(member, WebMember::poll_events).flatten())
}

/// Makes the session ready for another connection.
#[unsafe(no_mangle)]
pub extern "C" fn reconnect(member: u32) -> u32 {
    done(call(member, WebMember::reconnect))
}

/// Leaves the scene and closes the connection.
#[unsafe(no_mangle)]
pub extern "C" fn close(member: u32) {
    with(member, WebMember::close);
}

/// Computes the view of the present moment; returns it in ticks, or a negative number before the member has joined.
#[unsafe(no_mangle)]
pub extern "C" fn poll_view(member: u32, now: f64) -> f64 {
    let shown = with_at(member, now, WebMember::poll).flatten();
    shown.unwrap_or(-1.0)
}

/// Computes the view of a moment in ticks.
#[unsafe(no_mangle)]
pub extern "C" fn show(member: u32, now: f64, ticks: f64) {
    let whole = ticks.max(0.0).floor();
    let at = RenderTime {
        tick: Tick::new(whole as u64),
        fraction: ticks.max(0.0) - whole,
    };
    with_at(member, now, |member, now| member.show(now, at));
}

/// Number of bodies in the view.
#[unsafe(no_mangle)]
pub extern "C" fn count(member: u32) -> u32 {
    let columns = with(member, |member| {
        member.columns().map(|columns| columns.ids.len())
    });
    columns.flatten().unwrap_or(0) as u32
}

/// Grows when the ids, shapes or kinds of the view change.
#[unsafe(no_mangle)]
pub extern "C" fn generation(member: u32) -> u32 {
    let columns = with(member, |member| {
        member.columns().map(|columns| columns.generation)
    });
    columns.flatten().unwrap_or(0)
}

/// Place of a column of the view; null without one. 0 ids, 1 shapes, 2 kinds, 3 resting, 4 changed, 5 removed, 6 ticks of
/// updates, 7 error bounds, 8 tolerances, 9 positions, 10 rotations, 11 linear velocities, 12 angular velocities.
///
/// Columns 6 to 8 are computed by this call.
#[unsafe(no_mangle)]
pub extern "C" fn column(member: u32, column: u32) -> *const u8 {
    let place = with(member, |member| {
        match column {
            6 => member.compute(Columns::compute_update_ticks),
            7 => member.compute(Columns::compute_error_bounds),
            8 => member.compute(Columns::compute_tolerances),
            _ => {}
        }
        let columns = member.columns()?;
        let view = member.live_view()?.view();
        Some(match column {
            0 => columns.ids.as_ptr().cast(),
            1 => columns.shapes.as_ptr().cast(),
            2 => columns.kinds.as_ptr(),
            3 => columns.resting.as_ptr(),
            4 => columns.changed.as_ptr().cast(),
            5 => columns.removed.as_ptr().cast(),
            6 => columns.update_ticks.as_ptr().cast(),
            7 => columns.error_bounds.as_ptr().cast(),
            8 => columns.tolerances.as_ptr().cast(),
            9 if columns.origins.is_empty() => view.positions().as_ptr().cast(),
            9 => columns.origins.as_ptr().cast(),
            10 => view.rotations().as_ptr().cast(),
            11 => view.linear_velocities().as_ptr().cast(),
            12 => view.angular_velocities().as_ptr().cast(),
            _ => return None,
        })
    });
    place.flatten().unwrap_or(std::ptr::null())
}

/// Entries of a column: of 4 and 5 their own number, of the others that of the bodies.
#[unsafe(no_mangle)]
pub extern "C" fn column_entries(member: u32, column: u32) -> u32 {
    let entries = with(member, |member| {
        let columns = member.columns()?;
        Some(match column {
            4 => columns.changed.len(),
            5 => columns.removed.len(),
            _ => columns.ids.len(),
        })
    });
    entries.flatten().unwrap_or(0) as u32
}

/// Place of a body in the view; -1 if it is not in it.
#[unsafe(no_mangle)]
pub extern "C" fn place(member: u32, body: f64) -> i32 {
    let place = with(member, |member| {
        member.live_view()?.view().place(body_of(body)?)
    });
    place.flatten().map_or(-1, |place| place as i32)
}

/// Bound on a body's error at the moment shown, metres: infinite if it is not known, negative without the body.
#[unsafe(no_mangle)]
pub extern "C" fn error_bound(member: u32, body: f64) -> f64 {
    let bound = with(member, |member| member.error_bound(body_of(body)?));
    bound.flatten().unwrap_or(-1.0)
}

/// Bound on a body's error at a tick by what is known of it, metres; as [`error_bound`] otherwise.
#[unsafe(no_mangle)]
pub extern "C" fn tick_error_bound(member: u32, body: f64, tick: f64) -> f64 {
    let tick = Tick::new(tick as u64);
    let bound = with(member, |member| {
        member.tick_error_bound(body_of(body)?, tick)
    });
    bound.flatten().unwrap_or(-1.0)
}

/// The newest tick at which every body is within its tolerance.
#[unsafe(no_mangle)]
pub extern "C" fn complete_tick(member: u32) -> f64 {
    with(member, |member| member.complete_tick()).unwrap_or(0.0)
}

/// A body's description.
#[unsafe(no_mangle)]
pub extern "C" fn body(member: u32, body: f64) -> u32 {
    found(with(member, |member| member.body_json(body_of(body)?)).flatten())
}

/// A shape.
#[unsafe(no_mangle)]
pub extern "C" fn shape(member: u32, shape: u32) -> u32 {
    found(with(member, |member| member.shape_json(shape)).flatten())
}

/// A body's track.
#[unsafe(no_mangle)]
pub extern "C" fn track(member: u32, body: f64) -> u32 {
    found(with(member, |member| member.track_json(body_of(body)?)).flatten())
}

/// A part of a member's state as JSON: 0 joints, 1 config, 2 stream, 3 gravity, 4 digest, 5 bodies under authority, 6 the edges
/// of cells, 7 the cells that are taken.
#[unsafe(no_mangle)]
pub extern "C" fn state(member: u32, part: u32) -> u32 {
    let json = with(member, |member| match part {
        0 => member.joints_json(),
        1 => member.config_json(),
        2 => member.stream_json(),
        3 => member.gravity_json(),
        4 => member.digest_json(),
        5 => Some(member.authority_json()),
        6 => member.grid_json(),
        7 => Some(member.cells_json()),
        _ => None,
    });
    found(json.flatten())
}

/// Statistics.
#[unsafe(no_mangle)]
pub extern "C" fn statistics(member: u32, now: f64) -> u32 {
    found(with_at(member, now, |member, now| {
        member.statistics_json(now)
    }))
}

/// Milliseconds for which a client of this scene tries to resume by default.
#[unsafe(no_mangle)]
pub extern "C" fn resume_within(member: u32) -> f64 {
    with(member, |member| member.resume_within()).unwrap_or(0.0)
}

/// Requests the stream in the input.
#[unsafe(no_mangle)]
pub extern "C" fn change_stream(member: u32) -> u32 {
    let choice = read("stream", scene_argument::stream);
    done(choice.and_then(|choice| call(member, |member| member.change_stream(choice))))
}

/// Takes the cells in the input: `cells` with their streams, or those around a `point` by `bands`.
#[unsafe(no_mangle)]
pub extern "C" fn take_cells(member: u32) -> u32 {
    let cells = read("options", CellArguments::read);
    done(cells.and_then(|cells| call(member, |member| member.take_cells(&cells))))
}

/// Sets the tier policy in the input.
#[unsafe(no_mangle)]
pub extern "C" fn set_tier_policy(member: u32) -> u32 {
    let policy = read("policy", scene_argument::tier_policy);
    done(policy.and_then(|policy| call(member, |member| member.set_tier_policy(policy))))
}

/// Sets an option of the view: 0 the delay in ticks, 1 the lead in ticks, 2 whether corrections are smoothed.
#[unsafe(no_mangle)]
pub extern "C" fn set_option(member: u32, option: u32, value: f64) -> u32 {
    let checked = match option {
        0 => InvalidTicks::check_delay(value),
        1 => InvalidTicks::check_lead(value),
        _ => Ok(()),
    };
    if let Err(invalid) = checked {
        return done(Err(Failure::argument("ticks", invalid)));
    }
    done(call(member, |member| match option {
        0 => member.set_delay_ticks(value),
        1 => member.set_lead_ticks(value),
        _ => member.set_smooth(value != 0.0),
    }))
}

/// Queues the command in the input; its number is the output.
#[unsafe(no_mangle)]
pub extern "C" fn command(member: u32) -> u32 {
    let command = read("command", scene_argument::command);
    answer(command.and_then(|command| Ok(json!(call(member, |member| member.command(command))?))))
}

/// Queues the removal of shapes that no body has; their number is the output.
#[unsafe(no_mangle)]
pub extern "C" fn remove_unused_shapes(member: u32) -> u32 {
    answer(call(member, WebMember::remove_unused_shapes).map(|count| json!(count)))
}

/// Queues the bodies of the list in the input; their ids are the output.
#[unsafe(no_mangle)]
pub extern "C" fn add_bodies(member: u32) -> u32 {
    let bodies = read("bodies", |bodies| bodies.each(scene_argument::body));
    answer(bodies.and_then(|bodies| {
        let ids = call(member, |member| member.add_bodies(&bodies))?;
        Ok(ids.into_iter().map(id_number).collect())
    }))
}

/// Queues the queries of the list in the input; their number is the output.
#[unsafe(no_mangle)]
pub extern "C" fn query(member: u32) -> u32 {
    let queries = read("queries", |queries| queries.each(scene_argument::query));
    answer(queries.and_then(|queries| Ok(json!(call(member, |member| member.query(queries))?))))
}

/// Requests authority over the `bodies` in the input, within its `tolerance`.
#[unsafe(no_mangle)]
pub extern "C" fn take_authority(member: u32) -> u32 {
    let request = read("authority", |request| {
        let tolerance = scene_argument::tolerance(&request.field("tolerance")?)?;
        let bodies = request.field("bodies")?;
        let bodies: Result<Vec<_>, _> = bodies.items()?.map(|body| body.body()).collect();
        Ok((tolerance, bodies?))
    });
    done(request.and_then(|(tolerance, bodies)| {
        call(member, |member| member.take_authority(tolerance, &bodies))
    }))
}

/// Publishes the list of ids and states in the input; their tick is the output, or null.
#[unsafe(no_mangle)]
pub extern "C" fn publish(member: u32, now: f64) -> u32 {
    let states = read("states", |states| {
        states.each(|pair| {
            let state = scene_argument::body_state(&pair.field("state")?)?;
            Ok((pair.field("id")?.body()?, state))
        })
    });
    answer(states.and_then(|states| {
        let tick = with_at(member, now, |member, now| member.publish(now, &states))
            .unwrap_or_else(freed)?;
        Ok(json!(tick.map(Tick::value)))
    }))
}

/// Lets a lockstep scene step; the tick to wait for is the output.
#[unsafe(no_mangle)]
pub extern "C" fn advance(member: u32, now: f64) -> u32 {
    let tick = with_at(member, now, WebMember::advance).unwrap_or_else(freed);
    answer(tick.map(|tick| json!(tick.value())))
}

/// One while commands before the last advance are not answered yet.
#[unsafe(no_mangle)]
pub extern "C" fn awaits_answers(member: u32) -> u32 {
    with(member, |member| u32::from(member.awaits_answers())).unwrap_or(0)
}

/// Takes an advance back that the server denied.
#[unsafe(no_mangle)]
pub extern "C" fn give_up_advance(member: u32) {
    with(member, WebMember::give_up_advance);
}

/// Requests an inspection.
#[unsafe(no_mangle)]
pub extern "C" fn inspect(member: u32) -> u32 {
    done(call(member, WebMember::inspect))
}

/// Deletes the scene.
#[unsafe(no_mangle)]
pub extern "C" fn delete(member: u32) -> u32 {
    done(call(member, WebMember::delete))
}

fn slot(members: &mut [Option<WebMember>], member: u32) -> Option<&mut Option<WebMember>> {
    members.get_mut((member as usize).checked_sub(1)?)
}

fn with<T>(member: u32, act: impl FnOnce(&mut WebMember) -> T) -> Option<T> {
    MEMBERS.with_borrow_mut(|members| Some(act(slot(members, member)?.as_mut()?)))
}

/// The same at a moment of JavaScript's clock.
fn with_at<T>(
    member: u32,
    milliseconds: f64,
    act: impl FnOnce(&mut WebMember, Instant) -> T,
) -> Option<T> {
    with(member, |member| {
        let now = member.at(milliseconds);
        act(member, now)
    })
}

fn call<T>(
    member: u32,
    act: impl FnOnce(&mut WebMember) -> Result<T, Failure>,
) -> Result<T, Failure> {
    with(member, act).unwrap_or_else(freed)
}

fn freed<T>() -> Result<T, Failure> {
    Err(Failure::of("notNow", "the member was freed"))
}

/// Reads the JSON in the input. `place` names it in errors.
fn read<T>(
    place: &str,
    read: impl FnOnce(&Argument<'_>) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let json: Value = INPUT.with_borrow(|input| {
        serde_json::from_slice(input).map_err(|cause| Failure::argument("input", cause))
    })?;
    let asked = AskedFields::default();
    let argument = Argument::new(&json, place, &asked);
    let value = read(&argument)?;
    argument.check_fields()?;
    Ok(value)
}

fn put(bytes: &[u8]) {
    OUTPUT.with_borrow_mut(|output| {
        output.clear();
        output.extend_from_slice(bytes);
    });
}

fn found(json: Option<Value>) -> u32 {
    match json {
        None => 0,
        Some(json) => {
            put(json.to_string().as_bytes());
            1
        }
    }
}

fn fail(failure: &Failure) -> u32 {
    put(failure.to_json().to_string().as_bytes());
    0
}

fn answer(result: Result<Value, Failure>) -> u32 {
    match result {
        Ok(json) => found(Some(json)),
        Err(failure) => fail(&failure),
    }
}

fn done(result: Result<(), Failure>) -> u32 {
    answer(result.map(|()| Value::Null))
}
