"""Random numbers that are the same on a GPU and on a CPU."""

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

DRAWS = {
    *("rand", "rand_like", "randn", "randn_like", "randint", "randint_like", "randperm", "normal"),
    *("normal_", "uniform_", "random_", "bernoulli", "bernoulli_", "exponential_"),
}


class DrawnOnTheCpu(TorchDispatchMode):
    """Samples every random number with the CPU's generator, and moves it to the requested device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if func.overloadpacket.__name__ not in DRAWS:
            return func(*args, **kwargs)
        given = [value for value in tree_leaves((args, kwargs)) if isinstance(value, torch.Tensor)]
        device = kwargs.get("device") or (given[0].device if given else torch.device("cpu"))
        moved_args, moved_kwargs = tree_map_only(torch.Tensor, torch.Tensor.cpu, (args, kwargs))
        if "device" in kwargs:
            moved_kwargs["device"] = torch.device("cpu")
        drawn = func(*moved_args, **moved_kwargs).to(device)
        return args[0].copy_(drawn) if func._schema.is_mutable else drawn
