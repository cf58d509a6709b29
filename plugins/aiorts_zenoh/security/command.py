"""`aiorts certs`: certificates for kernels and people of a network."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts.errors import ConfigurationError
from aiorts_zenoh.security.access import ROLES
from aiorts_zenoh.security.folder import DAYS, Folder, default_folder


def _folder(ctx: click.Context, param: click.Parameter, path: Path | None) -> Folder:
    return Folder(path or default_folder())


_FOLDER: Final = click.option(
    "--folder",
    type=click.Path(path_type=Path),
    callback=_folder,
    help="Of the certificates, instead of ~/.config/aiorts/certs.",
)


@click.group(short_help="Make and check the certificates of a network.")
def certs() -> None:
    """Make and check the certificates by which kernels and people of a network know each other.

    A folder has an authority, and for each name a certificate, its key and its role. The key of the authority (ca.key)
    stays where it was made; to another machine go ca.pem, index.json, NAME.pem and NAME.key.
    """


@certs.command(short_help="Make a folder with an authority of its own.")
@_FOLDER
def init(folder: Folder) -> int:
    """Make a folder with an authority of its own."""
    folder.init()
    click.echo(f"{folder.path}: an authority; next: aiorts certs issue NAME --role component")
    return exits.DONE


@certs.command(short_help="Certify a name, or renew its certificate.")
@click.argument("name")
@click.option("--role", type=click.Choice(ROLES), default=None, help="What the name may do; needed at the first time.")
@click.option(
    "--address",
    "addresses",
    multiple=True,
    metavar="HOST",
    help="A host name or IP address at which it listens, beside the loopback; repeatable.",
)
@click.option("--days", type=click.FloatRange(0, 366, min_open=True), default=DAYS, show_default=True)
@_FOLDER
def issue(name: str, role: str | None, addresses: tuple[str, ...], days: float, folder: Folder) -> int:
    """Certify NAME, a kernel's or a person's, or renew its certificate.

    A viewer looks, an operator controls too, a component is a kernel, a coordinator a kernel that also operates others,
    and a router carries what others send.
    """
    made = folder.issue(name, role or "", addresses, days)
    click.echo(f"{made.certificate}: {made.name}, {made.role}, for {days:g} days")
    return exits.DONE


@certs.command("list", short_help="Show names, their roles, and until when.")
@_FOLDER
def list_(folder: Folder) -> int:
    """Show the names that have a certificate, what each may do, and until when."""
    lines = [_line(folder, name) for name in folder.names]
    for line in lines or ["no names; aiorts certs issue NAME --role component"]:
        click.echo(line)
    return exits.DONE


def _line(folder: Folder, name: str) -> str:
    role, denied = folder.names[name]
    if denied:
        return f"{name}  {role}  revoked"
    try:
        found = folder.facts(name)
    except ConfigurationError as error:
        return f"{name}  {role}  {error}"
    return f"{name}  {role}  until {found.ends:%Y-%m-%d %H:%M} UTC  {' '.join(found.addresses)}"


@certs.command(short_help="Look whether certificates can be used.")
@click.argument("names", nargs=-1)
@_FOLDER
def check(names: tuple[str, ...], folder: Folder) -> int:
    """Look at the certificates of NAMES, or at all in the folder: the status is 1 if one is not to be used.

    Names without a certificate in the folder, as on another machine, are looked at where they are named.
    """
    faults = 0
    for name in names or folder.held:
        try:
            found = folder.identity(name)
        except ConfigurationError as error:
            faults += 1
            click.echo(f"{name}: {error}")
        else:
            click.echo(f"{name}: {found.role}, good until {folder.facts(name).ends:%Y-%m-%d %H:%M} UTC")
    return exits.FAILED if faults else exits.DONE


@certs.command(short_help="Deny a name for good.")
@click.argument("name")
@_FOLDER
def revoke(name: str, folder: Folder) -> int:
    """Deny NAME for good: kernels and routers with this index take nothing from it, also those that run.

    Copy index.json to the other machines; what runs there goes by it within two seconds.
    """
    folder.revoke(name)
    click.echo(f"{name}: revoked; copy {folder.index} to the other machines, where it holds within two seconds")
    return exits.DONE
