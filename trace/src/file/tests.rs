//! Files of traces: every form is read back, a damaged one is refused.

use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};

use super::*;

fn facts() -> SceneFacts {
    SceneFacts {
        integrator: Integrator {
            rate: Rate::new(30_000, 1_001).unwrap(),
            substeps: NonZeroU32::new(4).unwrap(),
        },
        gravity: Vec3::new(0.0, -9.806_65, 1e-7),
        damping: Damping {
            linear: 0.0,
            angular: 0.05,
        },
    }
}

#[test]
fn facts_are_read_as_they_are_written() {
    let written = facts().to_metadata();
    assert_eq!(SceneFacts::of_metadata(&written), Some(facts()));
    for name in ["rate", "substeps", "gravity", "damping"] {
        for wrong in ["", "x", "0/0", "0", "NaN NaN NaN", "-1 -1"] {
            let mut spoiled = written.clone();
            spoiled.insert(name.to_owned(), wrong.to_owned());
            assert_eq!(SceneFacts::of_metadata(&spoiled), None, "{name} {wrong}");
        }
        let mut missing = written.clone();
        missing.remove(name);
        assert_eq!(SceneFacts::of_metadata(&missing), None, "{name}");
    }
}

#[test]
fn log_times_do_not_drift() {
    assert_eq!(log_time_ns(Rate::HZ_60, 0), 0);
    assert_eq!(log_time_ns(Rate::HZ_60, 1), 16_666_667);
    assert_eq!(log_time_ns(Rate::HZ_60, 2), 33_333_333);
    assert_eq!(log_time_ns(Rate::HZ_60, 60_000_000), 1_000_000_000_000_000);
    let film = Rate::new(30_000, 1_001).unwrap();
    assert_eq!(log_time_ns(film, 30_000), 1_001_000_000_000);
    assert_eq!(log_time_ns(film, u64::MAX), u64::MAX);
}

/// A file of ten messages on `/a`, in chunks of one message each, out of order, and one on `/b`.
fn file(options: WriteOptions, times: &[u64]) -> Vec<u8> {
    let mut writer = options
        .create(Cursor::new(Vec::new()))
        .expect("writing to memory succeeds");
    let schema = writer.add_schema("x.A", "protobuf", b"").unwrap();
    let a = writer
        .add_channel(schema, "/a", "protobuf", &BTreeMap::new())
        .unwrap();
    let b = writer
        .add_channel(0, "/b", "json", &BTreeMap::new())
        .unwrap();
    for (sequence, time) in times.iter().enumerate() {
        let header = MessageHeader {
            channel_id: a,
            sequence: sequence as u32,
            log_time: *time,
            publish_time: *time,
        };
        writer
            .write_to_known_channel(&header, &[*time as u8; 1_000])
            .unwrap();
        writer.flush().unwrap();
    }
    let header = MessageHeader {
        channel_id: b,
        sequence: 0,
        log_time: 3,
        publish_time: 3,
    };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    let metadata = Metadata {
        name: "of.it".to_owned(),
        metadata: BTreeMap::new(),
    };
    writer.write_metadata(&metadata).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

const TIMES: [u64; 5] = [7, 2, 9, 4, 2];

fn times(contents: &FileContents) -> Vec<u64> {
    let messages = contents.messages.iter();
    messages.map(|message| message.log_ns).collect()
}

fn forms() -> Vec<WriteOptions> {
    [None, Some(Compression::Zstd), Some(Compression::Lz4)]
        .into_iter()
        .flat_map(|compression| {
            let plain = WriteOptions::new().compression(compression);
            let bare = plain
                .clone()
                .emit_summary_records(false)
                .emit_message_indexes(false)
                .calculate_chunk_crcs(false);
            let unchunked = plain.clone().use_chunks(false);
            [plain, bare, unchunked]
        })
        .collect()
}

#[test]
fn every_compression_with_and_without_summary_and_chunks_is_read_in_the_order_of_time() {
    for options in forms() {
        let bytes = file(options, &TIMES);
        let contents = FileContents::read(&bytes, &|channel| channel.topic == "/a").unwrap();
        assert_eq!(times(&contents), [2, 2, 4, 7, 9]);
        assert_eq!(contents.message_count, 6);
        assert_eq!(contents.end, FileEnd::Whole);
        assert_eq!(contents.note(), None);
        assert_eq!(contents.metadata[0].0, "of.it");
        assert_eq!(contents.topic(&contents.messages[0]), "/a");
        let schema = contents.channels.values().map(|channel| &*channel.schema);
        assert_eq!(schema.collect::<Vec<_>>(), ["x.A", ""]);
    }
}

#[test]
fn a_file_that_ends_early_gives_what_stands_before_its_end() {
    for options in forms() {
        let bytes = file(options, &TIMES);
        let mut most = 0;
        for length in (MAGIC.len()..bytes.len()).step_by(5) {
            let contents = FileContents::read(&bytes[..length], &|_| true).unwrap();
            assert!(contents.message_count >= most, "more bytes hold no fewer");
            most = contents.message_count;
            if contents.end == FileEnd::Early {
                let note = contents.note().unwrap();
                assert!(note.contains(&format!("its {most} whole")), "{note}");
            }
            let begun = contents.check_begun(length);
            assert_eq!(
                begun.is_err(),
                contents.channels.is_empty(),
                "{length} bytes"
            );
            if let Err(cut) = begun {
                let cut = cut.to_string();
                assert!(
                    cut.contains(&format!("after {length} bytes, within")),
                    "{cut}"
                );
            }
        }
        assert_eq!(most, 6);
    }
}

#[test]
fn another_file_and_a_damaged_one_are_refused() {
    let bytes = file(WriteOptions::new().compression(None), &TIMES);
    assert!(matches!(
        FileContents::read(b"time,body", &|_| true),
        Err(ContentsError::NotMcap)
    ));
    let body = bytes.windows(1_000).position(|bytes| bytes == [9; 1_000]);
    let mut changed = bytes.clone();
    changed[body.unwrap() + 5] = 8;
    let refused = FileContents::read(&changed, &|_| true).unwrap_err();
    let refused = refused.to_string();
    assert!(refused.contains("behind its first 3 messages"), "{refused}");
}
