#!/usr/bin/env python3
"""Reads traces and recordings with the public MCAP reader of Python: every message, and what is left of a cut file.

Usage: read.py COUNTS TRACE RECORDING... --cut FILE --merged FILE. Writes to COUNTS what other readers must find, as JSON: for each
file the messages of each topic, and for the cut one the number of whole messages. Writes the recordings into the merged file,
by the rules of `mcap merge`.
"""

import json
import struct
import sys

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory


def read(path):
    """The messages of each topic; checks each one on the way."""
    counts, last, most = {}, {}, 0
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        names = [record.name for record in reader.iter_metadata()]
        assert len(names) == len(set(names)), f"{path}: two metadata records have one name, so files cannot be merged"
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            topic = channel.topic
            counts[topic] = counts.get(topic, 0) + 1
            assert message.log_time >= last.get(topic, 0), f"{path}: {topic} goes back in time"
            last[topic] = message.log_time
            if schema.name == "rhumb.States":
                # One rule for log times: tick times step, rounded; 60 Hz in these scenes.
                assert message.log_time == round(decoded.tick * 1e9 / 60), f"{path}: {topic} at tick {decoded.tick}"
            if schema.name == "foxglove.PosesInFrame":
                assert decoded.frame_id == "map"
                most = max(most, len(decoded.poses))
        statistics = reader.get_summary().statistics
        assert statistics.message_count == sum(counts.values()), f"{path}: the summary counts others"
    assert most > 0, f"{path}: no poses"
    return counts


def read_cut(path):
    """Whole messages of a file without an end."""
    count = 0
    with open(path, "rb") as file:
        try:
            for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
                count += 1
        # The reader has an error for an end between two records, and none for one within a record.
        except (McapError, EOFError, ValueError, struct.error):
            pass
    assert count > 0, f"{path}: nothing is left"
    return count


def merge(paths, merged):
    """All messages of these files in the order of time; two metadata records of one name are an error."""
    messages, names = [], set()
    with open(merged, "wb") as to:
        writer = Writer(to, compression=CompressionType.LZ4)
        writer.start()
        for path in paths:
            with open(path, "rb") as file:
                reader = make_reader(file)
                for record in reader.iter_metadata():
                    assert record.name not in names, f"metadata name {record.name} was previously encountered"
                    names.add(record.name)
                    writer.add_metadata(record.name, record.metadata)
                ids = {}
                for schema, channel, message in reader.iter_messages():
                    if channel.id not in ids:
                        own = writer.register_schema(schema.name, schema.encoding, schema.data)
                        ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, own, channel.metadata)
                    messages.append((message.log_time, len(messages), ids[channel.id], message))
        for at, _, channel, message in sorted(messages, key=lambda of: of[:2]):
            writer.add_message(channel, at, message.data, message.publish_time, message.sequence)
        writer.finish()


def main():
    counts, *files = sys.argv[1:]
    merged, cut = files.pop(), files[-2]
    assert files[-3::2] == ["--cut", "--merged"]
    files = files[:-3]
    merge(files[1:], merged)
    found = {"files": {path: read(path) for path in files}, "cut": [cut, read_cut(cut)]}
    with open(counts, "w", encoding="utf-8") as file:
        json.dump(found, file)
    total = sum(sum(topics.values()) for topics in found["files"].values())
    print(f"ok: {total} messages of {len(files)} files, {found['cut'][1]} of one without an end")


main()
