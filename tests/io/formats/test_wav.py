"""WAV files: scipy's reader and writer are the independent second; what the headers lack or say wrongly is one line."""

import struct

import numpy as np
import pytest
from scipy.io import wavfile

from millcal.cli import main
from millcal.errors import RecordingError
from millcal.io.formats import wav
from millcal.io.inspection import inspect_recording
from millcal.io.recordings import read_recording, write_recording

RATE = 44_100


def sound(channels=2, n=5000):
    rng = np.random.default_rng(3)
    return np.clip(0.3 * rng.normal(size=(n, channels)), -1, 0.999)


def chunk(name, body):
    return name + struct.pack("<I", len(body)) + body + b"\x00" * (len(body) % 2)


def form(code=1, channels=1, rate=RATE, bits=16, more=b""):
    frame = channels * bits // 8
    return chunk(b"fmt ", struct.pack("<HHIIHH", code, channels, rate, rate * frame, frame, bits) + more)


def riff(*chunks):
    body = b"WAVE" + b"".join(chunks)
    return b"RIFF" + struct.pack("<I", len(body)) + body


SAMPLES = np.arange(-50, 50, dtype="<i2")


@pytest.mark.parametrize(
    ("kind", "full"), [(np.int16, 2**15), (np.int32, 2**31), (np.uint8, 2**7), (np.float32, 1.0), (np.float64, 1.0)]
)
@pytest.mark.parametrize("channels", [1, 2, 6])
def test_samples_are_shares_of_full_scale_as_an_independent_writer_stores_them(tmp_path, kind, full, channels):
    path = tmp_path / "cut.wav"
    stored = sound(channels) * (full if kind != np.uint8 else full - 1)
    stored = stored.astype(kind) if kind != np.uint8 else (np.round(stored) + 128).astype(kind)
    wavfile.write(path, RATE, stored if channels > 1 else stored[:, 0])
    recording = read_recording(path)
    expected = stored.astype(float) / full if kind != np.uint8 else (stored.astype(float) - 128) / 128
    assert np.array_equal(recording.samples, expected.T)
    assert recording.sample_rate == RATE
    assert [c.quantity for c in recording.channels] == ["sound"] * channels
    assert {c.unit for c in recording.channels} == {"FS"}


def test_24_bits_are_read_as_scipy_reads_them(tmp_path):
    whole = np.random.default_rng(1).integers(-(2**23), 2**23, (300, 2))
    body = b"".join(int(v).to_bytes(3, "little", signed=True) for v in whole.reshape(-1))
    path = tmp_path / "deep.wav"
    path.write_bytes(riff(form(channels=2, bits=24), chunk(b"data", body)))
    assert np.array_equal(read_recording(path).samples, whole.T / 2**23)
    assert np.array_equal(wavfile.read(path)[1].T / 2**31, whole.T / 2**23)


def test_any_part_of_a_file_is_that_part_of_the_whole(tmp_path):
    path = tmp_path / "cut.wav"
    wavfile.write(path, RATE, sound(3).astype(np.float32))
    source = wav.open_source(path)
    whole = source.read_block(0, source.rows)
    assert np.array_equal(np.concatenate([source.read_block(0, 777), source.read_block(777, 5000)], axis=1), whole)
    assert np.array_equal(source.read_rows(100, 200, [2, 0]), whole[[2, 0], 100:200])
    assert source.read_block(4990, 6000).shape == (3, 10)


def test_chunks_that_are_not_of_the_sound_are_passed_over_odd_ones_too(tmp_path):
    path = tmp_path / "tagged.wav"
    path.write_bytes(
        riff(
            chunk(b"LIST", b"odd"),
            form(),
            chunk(b"bext", bytes(602)),
            chunk(b"data", SAMPLES.tobytes()),
            chunk(b"id3 ", b"x"),
        )
    )
    assert np.array_equal(read_recording(path).samples[0] * 2**15, SAMPLES)


def test_extensible_rf64_and_piped_files_hold_the_same_samples(tmp_path):
    body, more = SAMPLES.tobytes(), struct.pack("<HHIH14s", 22, 16, 4, 1, bytes(14))
    ds64 = chunk(b"ds64", struct.pack("<QQQI", 0, len(body), len(SAMPLES), 0))
    endless = b"data" + struct.pack("<I", wav.UNKNOWN_SIZE) + body
    written = {
        "extensible": riff(form(0xFFFE, more=more), chunk(b"data", body)),
        "rf64": b"RF64\xff\xff\xff\xffWAVE" + ds64 + form() + endless + chunk(b"tail", bytes(64)),
        "piped": riff(form(), endless),
    }
    for name, content in written.items():
        path = tmp_path / f"{name}.wav"
        path.write_bytes(content)
        recording = read_recording(path)
        assert np.array_equal(recording.samples[0] * 2**15, SAMPLES), name
        assert not [n for n in recording.notices if n.level == "warning"], name


def test_a_file_that_lost_its_end_is_read_as_far_as_it_goes_with_a_warning(tmp_path):
    path = tmp_path / "short.wav"
    wavfile.write(path, RATE, sound(1, 44_100)[:, 0].astype(np.float32))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2 + 1])
    recording = read_recording(path)
    assert recording.samples.shape[1] == pytest.approx(22_050, abs=20)
    assert [n.code for n in recording.notices if n.level == "warning"] == ["cut-short"]


REFUSED = {
    "not a wave": (b"RIFF\x24\x00\x00\x00AVI LIST" + bytes(40), "a film"),
    "only a beginning": (b"RIFF", "cut short"),
    "no format": (riff(chunk(b"data", bytes(200))), "damaged"),
    "no samples": (riff(form()), "cut short before its samples begin"),
    "empty": (riff(form(), chunk(b"data", b"")), "only 0 samples"),
    "format cut": (riff(form())[:25], "cut short|damaged"),
    "no channels": (riff(form(channels=0), chunk(b"data", bytes(200))), "0 channels"),
    "no rate": (riff(form(rate=0), chunk(b"data", bytes(200))), "0 samples per second"),
    "12 bits in 9 bytes": (riff(form(bits=72), chunk(b"data", bytes(720))), "72 bits"),
    "compressed": (riff(form(code=0x55), chunk(b"data", bytes(200))), "MP3"),
    "noise named wav": (b"\x00\x01" * 300, "no WAV file"),
    "silent": (riff(form(), chunk(b"data", bytes(400))), "constant"),
    "m4a": (b"\x00\x00\x00\x20ftypM4A " + bytes(200), "save the sound as WAV"),
    "mp3": (b"ID3\x04" + bytes(200), "save the sound as WAV"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_one_line_and_exit_code_3(tmp_path, capsys, name):
    content, said = REFUSED[name]
    path = tmp_path / "cut.wav"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=said):
        read_recording(path)
    judge = ["judge", str(path), "--teeth", "2", "--rpm", "6000"]
    for command in (judge, ["ingest", str(path), "-o", str(tmp_path / "c.h5")]):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 3
        told = capsys.readouterr()
        assert told.out == ""
        assert len(told.err.strip().splitlines()) == 1
        assert told.err.startswith("error: ")
    assert not (tmp_path / "c.h5").exists()


def test_a_stated_sensitivity_makes_pascals_and_the_range_goes_with_it(tmp_path):
    path = tmp_path / "cut.wav"
    wavfile.write(path, RATE, sound(1)[:, 0].astype(np.float32))
    plain, stated = read_recording(path), read_recording(path, units={"sound": "0.05 FS/Pa"})
    assert stated.channels[0].quantity == "sound_pressure"
    assert np.allclose(stated.samples, 20 * plain.samples, rtol=1e-14)
    assert (plain.channels[0].full_scale, stated.channels[0].full_scale) == (1.0, 20.0)
    assert [n.code for n in plain.notices] == ["full-scale"]
    assert not stated.notices
    with pytest.raises(RecordingError, match="is in FS, and '100 mV/g' is for a column in V"):
        read_recording(path, units={"sound": "100 mV/g"})


def test_a_sound_outlives_the_recording_format(tmp_path):
    path = tmp_path / "cut.wav"
    wavfile.write(path, RATE, (2**15 * sound(2)).astype(np.int16))
    first = read_recording(path)
    write_recording(tmp_path / "cut.h5", first, counts=True)
    again = read_recording(tmp_path / "cut.h5")
    assert np.array_equal(again.samples, first.samples)
    assert again.channels == first.channels
    told, _ = inspect_recording(path)
    assert (told["format"], told["missing"], told["channels"][0]["unit"]) == ("wav", [], "FS")
