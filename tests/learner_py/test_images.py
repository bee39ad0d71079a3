"""Training from images: the same promises as from states, with the same bits."""

from __future__ import annotations

import dataclasses
import hashlib
import io
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import runtime
import support
from PIL import Image

from tandem.images import decode
from tandem.learner.episode import Episode
from tandem.learner.method import shifted
from tandem.learner.trainer import Trainer
from tandem.policy_file import read_safetensors

HEIGHT, WIDTH = 24, 16  # of the camera in support.scenario_data


def jpeg(number: int, step: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """Another picture for each observation."""
    generator = np.random.default_rng([number, step])
    small = generator.integers(0, 256, (4, 4, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(small).resize(size).save(file, "JPEG", quality=90)
    return file.getvalue()


def with_images(episode: Episode) -> Episode:
    images = tuple(jpeg(episode.number, t) for t in range(episode.n_steps + 1))
    return dataclasses.replace(episode, images=images)


def stream() -> list[Episode]:
    episodes = [support.demonstration(0, n_steps=6), support.demonstration(1, n_steps=5)]
    episodes += [
        support.episode(n, intervention=[0, 1, 1, 0, 0], env_steps_total=5 * (n - 1)) for n in (2, 3)
    ]
    return [with_images(episode) for episode in episodes]


def learn(trainer: Trainer, episodes: list[Episode] | None = None) -> Trainer:
    for episode in stream() if episodes is None else episodes:
        trainer.ingest(episode)
        if episode.number > trainer.position.episodes_trained_through:
            trainer.train(episode, lambda report: True)
    return trainer


# samples and the critic's choice; an actor whose gradient must not reach the encoder, and a slow critic
METHODS = ["tandem", "hil_serl"]


@pytest.fixture(scope="module", params=METHODS)
def trained(request: Any, compile_once: None) -> Trainer:
    return learn(Trainer(support.scenario(method=request.param, observe="image", warm_start_updates=10)))


def again(trainer: Trainer) -> Trainer:
    return Trainer(trainer.scenario)


def test_resumed_run_equals_the_uninterrupted_one(trained: Trainer, tmp_path: Any) -> None:
    learn(again(trained), stream()[:3]).save(tmp_path / "checkpoint")
    resumed = again(trained)
    resumed.restore(tmp_path / "checkpoint")
    learn(resumed)
    assert support.tree_bytes(resumed.state) == support.tree_bytes(trained.state)


def test_buffer_from_the_log_equals_the_live_one_and_holds_the_images(
    trained: Trainer, tmp_path: Any
) -> None:
    """Through the messages, as the log has them."""
    from tandem.log import episodes

    support.write_log(tmp_path / "log.lcm", [episode.to_messages() for episode in stream()])
    rebuilt = again(trained)
    for episode in episodes(tmp_path / "log.lcm"):
        rebuilt.ingest(episode)
    assert rebuilt.buffer.sha256() == trained.buffer.sha256()
    rows = np.asarray(rebuilt.buffer.arrays["image"])
    np.testing.assert_array_equal(rows[7], decode(jpeg(1, 1)))  # after the six of episode 0
    if "next_image" in rebuilt.buffer.arrays:
        following = np.asarray(rebuilt.buffer.arrays["next_image"])
        np.testing.assert_array_equal(following[4], decode(jpeg(0, 5)))
        np.testing.assert_array_equal(following[5], decode(jpeg(0, 6)))  # the end, and not the next episode


def test_deployed_policy_computes_in_cpp_what_the_learner_computes(trained: Trainer, tmp_path: Any) -> None:
    trained.write_policy(tmp_path / "policy.safetensors")
    tensors = read_safetensors(tmp_path / "policy.safetensors")[0]
    assert tensors["encoder.backbone.0.weight"].shape == (4, 3, 5, 5)
    for kernel in ("", "scalar"):
        assert runtime.info(tmp_path / "policy.safetensors", kernel)["golden_error"] <= 1e-5
    generator = np.random.default_rng(5)
    inputs = {
        "observation": generator.normal(size=(8, 3)).astype(np.float32),
        "image.wrist": generator.integers(0, 256, (8, HEIGHT, WIDTH, 3), np.uint8),
    }
    noise = generator.standard_normal((8, trained.method.noise_size), np.float32)
    inputs |= {"noise": noise} if noise.size else {}
    theirs = trained.act(inputs["observation"], noise, inputs["image.wrist"])
    ours = runtime.run(tmp_path / "policy.safetensors", inputs)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    black = trained.act(inputs["observation"], noise, 0 * inputs["image.wrist"])
    assert np.abs(black - theirs).max() > 1e-3, "the images make no difference"


def test_encoder_learns_from_the_losses_that_may_teach_it() -> None:
    def change(**image: Any) -> float:
        scenario = support.scenario(
            method="bc", observe="image", warm_start_updates=10, image={"shift_px": 0, **image}
        )
        before = jax.tree.leaves(Trainer(scenario).state.encoder["encoder"]["backbone"])
        after = jax.tree.leaves(learn(Trainer(scenario)).state.encoder["encoder"]["backbone"])
        return max(float(jnp.abs(a - b).max()) for a, b in zip(before, after, strict=True))

    assert change(rest_weight=0.0) > 1e-3
    assert change(actor_teaches=False) > 1e-3, "how far it still went teaches whoever else does"
    assert change(actor_teaches=False, rest_weight=0.0) == 0.0  # bc has no critic


def test_shift_moves_each_image_by_its_own_few_pixels_and_repeats_the_edge() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 9, 7, 3), np.uint8)
    moved = np.asarray(shifted(jnp.asarray(image), jax.random.PRNGKey(1), 2))
    padded = np.pad(image, ((0, 0), (2, 2), (2, 2), (0, 0)), mode="edge")
    found = set()
    for before, after in zip(padded, moved, strict=True):
        where = [(y, x) for y in range(5) for x in range(5) if (before[y : y + 9, x : x + 7] == after).all()]
        assert len(where) == 1
        found.add(where[0])
    assert len(found) > 15  # of the 25


def test_decoder_gives_the_pixels_that_the_controllers_gives() -> None:
    """tests/controller/camera/camera_test.cpp decodes the same file to the same digest."""
    pixels = decode((Path(__file__).parents[1] / "support" / "wrist.jpg").read_bytes())
    assert pixels.shape == (64, 64, 3)
    wanted = "ad19b952f6007d182e74a9255b1643d6b0c3f6ca693870584459fe98809e83f1"
    assert hashlib.sha256(pixels.tobytes()).hexdigest() == wanted


def test_images_that_are_missing_or_of_another_size_end_in_a_sentence() -> None:
    scenario = support.scenario(method="bc", observe="image")
    with pytest.raises(
        ValueError, match=r"Episode 0 has no images; it was recorded without run.observe image"
    ):
        Trainer(scenario).ingest(support.demonstration(0))
    small = support.demonstration(0)
    small = dataclasses.replace(small, images=tuple(jpeg(0, t, (16, 16)) for t in range(6)))
    with pytest.raises(
        ValueError, match=r"images of 16 x 16 px; controller.camera of the scenario says 16 x 24"
    ):
        Trainer(scenario).ingest(small)
    steps, end = with_images(support.demonstration(0)).to_messages()
    steps[2].image, steps[2].n_image = b"", 0
    with pytest.raises(ValueError, match="lacks the image of observation 2"):
        Episode.from_messages(steps, end)


def test_state_runs_keep_no_images() -> None:
    trainer = Trainer(support.scenario(method="tandem"))
    trainer.ingest(with_images(support.demonstration(0)))
    assert "image" not in trainer.buffer.arrays
    assert trainer.state.encoder == {} and trainer.state.encoder_optimizer == ()
