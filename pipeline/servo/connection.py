"""How to reach a servo controller: its port, or a dry run."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.fabrication.timeline_file import read_calibration
from pipeline.servo.servo_controller import ControllerError, DryRunController, ServoController
from tasks.fabrication.calibration import Calibration


@dataclass(frozen=True, kw_only=True)
class Connection:
    """Options that choose a controller."""

    port: str | None = None
    dry_run: bool = False
    baud: int = 115200
    baud_detection: bool = False
    timeout: float = 0.1  # longest wait for an answer of the controller [s]


def port_lines() -> list[str]:
    """List this computer's serial ports and mark those of a Maestro."""
    from serial.tools.list_ports import comports

    from pipeline.servo.maestro import PRODUCT_IDS, VENDOR_ID

    lines = []
    for port in sorted(comports(), key=lambda one: one.device):
        is_maestro = port.vid == VENDOR_ID and port.pid in PRODUCT_IDS
        lines.append(f"{port.device}  {port.description}{'  <- a Maestro' if is_maestro else ''}")
    advice = "A Maestro has two ports. Pass its Command Port, usually the first, to --port."
    return [*lines, advice] if lines else ["No serial port found. Is the controller plugged in?"]


def open_controller(connection: Connection) -> ServoController:
    """Open the controller that the user chose. Add other kinds of controllers here."""
    if connection.dry_run:
        return DryRunController()
    if connection.port is None:
        raise PuddleError("--port: expected the controller's port (`puddle servo play --list-ports`), or --dry-run")
    from pipeline.servo.maestro import open_maestro

    return open_maestro(
        connection.port, baud=connection.baud, baud_detection=connection.baud_detection, timeout=connection.timeout
    )


def calibration_at(path: Path) -> tuple[Path, Calibration]:
    """Read the calibration of a kit, or a calibration file. Return its path too."""
    file = path / "calibration.yaml" if path.is_dir() else path
    return file, read_calibration(file)


def switch_off(controller: ServoController, calibration: Calibration) -> None:
    """Stop the pulses of all servos, and read back that they stopped.

    Raises:
        PortLostError: The port failed.
        ControllerError: The controller reports an error, or still puts out a pulse.
    """
    channels = tuple(servo.channel for servo in calibration.servos)
    try:
        controller.prepare({})
    finally:  # even if the controller does not answer, it may receive
        controller.off(channels)
    for channel in channels:
        if position := controller.position(channel):
            raise ControllerError(
                f"{controller.name}: channel {channel} is switched off but puts out {position:g} µs. Cut the servos' "
                f"power if they hold or move"
            )
