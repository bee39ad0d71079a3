"""Our update in PyTorch eager: `python3 torch_update.py WORK`, a program of its own that needs torch and NumPy only.

Orders and work file: src/learner_py/tandem/learner_bench. Written as somebody would who wants the best of eager mode on
a CPU: a product for each member of the ensemble (batched ones are slow without MKL), fused (foreach) optimisers and
averages, float32, one thread.
"""

import json
import math
import sys
import time

import numpy as np
import torch
from torch.nn import functional

NORM_EPSILON = 1e-6


def layers_of(given, name):
    """A list of dicts of trainable arrays."""
    found = []
    while f"{name}.{len(found)}.weight" in given:
        prefix = f"{name}.{len(found)}."
        found.append(
            {
                key[len(prefix) :]: torch.from_numpy(given[key]).clone().requires_grad_()
                for key in given.files
                if key.startswith(prefix)
            }
        )
    return found


def critic_values(layers, observation, chunk):
    """(M, B): the members' layers are (M, out, in), normalised before ReLU."""
    inputs = torch.cat([observation, chunk.flatten(1)], 1)
    values = []
    for member in range(len(layers[0]["weight"])):
        x = inputs
        for layer in layers[:-1]:
            y = functional.linear(x, layer["weight"][member], layer["bias"][member])
            scale, offset = layer["norm_scale"][member], layer["norm_offset"][member]
            x = functional.relu(functional.layer_norm(y, y.shape[-1:], scale, offset, NORM_EPSILON))
        values.append(functional.linear(x, layers[-1]["weight"][member], layers[-1]["bias"][member])[:, 0])
    return torch.stack(values)


def flow_error(layers, observation, target, noise, moment, n_features):
    action = noise + moment[:, None, None] * (target - noise)
    angle = math.pi * moment[:, None] * torch.arange(1, n_features // 2 + 1)
    x = torch.cat([observation, action.flatten(1), torch.cos(angle), torch.sin(angle)], 1)
    for layer in layers[:-1]:
        x = functional.relu(functional.linear(x, layer["weight"], layer["bias"]))
    velocity = functional.linear(x, layers[-1]["weight"], layers[-1]["bias"]).view_as(target)
    return functional.mse_loss(velocity, target - noise)


class Update:
    def __init__(self, given):
        self.settings = json.loads(str(given["settings"]))
        self.critic, self.actor = layers_of(given, "critic"), layers_of(given, "actor")
        self.rows = {
            name: torch.from_numpy(given[f"rows.{name}"]) for name in ("observation", "chunk", "mc_return")
        }
        self.noise, self.time = torch.from_numpy(given["noise"]), torch.from_numpy(given["time"])
        parameters = [
            [array for layer in layers for array in layer.values()] for layers in (self.critic, self.actor)
        ]
        rate = self.settings["learning_rate"]
        self.optimizers = [
            torch.optim.AdamW(
                parameters[0], lr=rate, weight_decay=self.settings["weight_decay"], foreach=True
            ),
            torch.optim.Adam(parameters[1], lr=rate, foreach=True),
        ]
        self.live = [array for group in parameters for array in group]
        self.average = [array.detach().clone() for array in self.live]

    def losses(self, critic_rows, actor_rows, noise, moment):
        values = critic_values(
            self.critic, self.rows["observation"][critic_rows], self.rows["chunk"][critic_rows]
        )
        critic = (values - self.rows["mc_return"][critic_rows]).square().mean(1).sum()
        observation, target = self.rows["observation"][actor_rows], self.rows["chunk"][actor_rows]
        actor = flow_error(self.actor, observation, target, noise, moment, self.settings["time_features"])
        return critic, actor

    def first_losses(self):
        rows = torch.arange(len(self.time))
        return [float(loss) for loss in self.losses(rows, rows, self.noise, self.time)]

    def once(self):
        batch = self.settings["batch"]
        draw = [torch.randint(len(self.rows["mc_return"]), (batch,)) for _ in range(2)]
        losses = self.losses(*draw, torch.randn_like(self.noise), torch.rand(batch))
        for loss, optimizer in zip(losses, self.optimizers, strict=True):
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
        with torch.no_grad():
            torch._foreach_mul_(self.average, self.settings["ema"])
            torch._foreach_add_(self.average, self.live, alpha=1 - self.settings["ema"])


def main():
    torch.set_num_threads(1)
    update = Update(np.load(sys.argv[1]))
    first = update.first_losses()
    for _ in range(5):
        update.once()
    print(json.dumps({"version": torch.__version__}), flush=True)
    for line in sys.stdin:
        order, count = line.split()
        if order == "losses":
            answer = first
        else:
            began = time.perf_counter()
            for _ in range(int(count)):
                update.once()
            answer = [(time.perf_counter() - began) / int(count) * 1e6]
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
