"""`desim merge`: the stores of several commands in one."""

from contextlib import ExitStack
from pathlib import Path

import click

from desim.cli.options import MIX_VERSIONS, PATH, out_to
from desim.cli.output import echo, fail, storing
from desim.cli.result_files import record_command
from desim.config.file_names import STORE, STORES, TRACE
from desim.config.number_texts import counted


@click.command()
@click.argument("stores", nargs=-1, required=True, type=PATH)
@out_to("Folder of the merged store.", required=True)
@MIX_VERSIONS
def merge(stores: tuple[Path, ...], out: Path, mix_versions: bool) -> None:
    """Merge the runs of several stores (files or folders) of one sweep into one store."""
    from desim.study.store.store import Store

    with storing(out), ExitStack() as opened:
        parts = [opened.enter_context(Store(path, read_only=True)) for path in store_files(stores)]
        # `Store.merge` checks this, too; here it is checked before the first store is merged, so that `out` is not
        # touched if a later one does not belong to the same sweep.
        for part in parts:
            parts[0].check_same(part.about)
            parts[0].check_versions(part.versions, subject=f"{part.path} has those of", mix=mix_versions)
        store = opened.enter_context(Store(out / STORE))
        for part in parts:
            store.merge(part, mix_versions=mix_versions)
        count, names = len(store), [str(part.path) for part in parts]
        # An empty store has no root seed.
        root = store.read_property("root seed", int) if "root seed" in store.about else 0
        record_command(store, out, "merge", seed=root, runs=count, stores=names)
    echo(f"{counted(count, 'run')} {'is' if count == 1 else 'are'} in {out / STORE}")


def store_files(stores: tuple[Path, ...]) -> list[Path]:
    """Return the files of stores; a folder stands for the stores in it, of a whole sweep or of its shards."""
    return [file for source in stores for file in (_stores_in(source) if source.is_dir() else [source])]


def _stores_in(folder: Path) -> list[Path]:
    """Return the files of the stores in a folder; end the program if it has none."""
    from desim.study.sweeps.folder import contents

    stores = sorted(folder.glob(STORES))
    if not stores:
        has_run = (folder / TRACE).exists()
        fail(f"{folder}: {'is the folder of a run, not of a sweep' if has_run else contents(folder)}")
    return stores
