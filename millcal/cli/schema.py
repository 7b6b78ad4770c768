"""The JSON schema of recipes: `millcal schema`."""

from typing import Annotated

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, reply


def schema(
    setup: Annotated[bool, typer.Option("--setup", help="The schema of SETUP.toml instead.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Print the JSON schema of recipes, for editors that complete and check TOML.

    Example: millcal schema > recipe.schema.json
    """
    import json

    from millcal.io.keys import SetupTables
    from millcal.io.recipe_tables import RecipeTables

    tables = SetupTables if setup else RecipeTables
    found = {"$schema": "https://json-schema.org/draft/2020-12/schema", **tables.model_json_schema()}
    reply("schema", json.dumps(found, indent=1), found, inputs={}, notices=(), as_json=as_json, quiet=quiet)
