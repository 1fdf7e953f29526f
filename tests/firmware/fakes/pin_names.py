"""Which pin of the processor a name means on a board of ours, as MicroPython finds it.

It looks a name up among those of the board first, and then among those of the processor
(ports/stm32/pin.c, `pin_find`). So "A5" is pin A5 of the Arduino connector where a board has one,
and the processor's port A, pin 5, elsewhere.
"""

#: Names of pins by board, as in MicroPython 1.29: ports/stm32/boards/NUCLEO_G474RE/pins.csv, all
#: that name pins of the Arduino connectors and LD2; PYBV11/pins.csv, both rows; WEACTSTUDIO_MINI_
#: STM32H743/pins.csv calls pins as the processor does; and ports/mimxrt/boards/TEENSY41/pins.csv.
NUCLEO = (
    "A0 PA0 A1 PA1 A2 PA4 A3 PB0 A4 PC1 A5 PC0 D0 PC5 D1 PC4 D2 PA10 D3 PB3 D4 PB5 D5 PB4 D6 PB10 "
    "D7 PA8 D8 PA9 D9 PC7 D10 PB6 D11 PA7 D12 PA6 D13 PA5 D14 PB9 D15 PB8 LED1 PA5 SW PC13"
)
PYBOARD = (
    "X1 PA0 X2 PA1 X3 PA2 X4 PA3 X5 PA4 X6 PA5 X7 PA6 X8 PA7 X9 PB6 X10 PB7 X11 PC4 X12 PC5 "
    "X17 PB3 X18 PC13 X19 PC0 X20 PC1 X21 PC2 X22 PC3 Y1 PC6 Y2 PC7 Y3 PB8 Y4 PB9 Y5 PB12 Y6 PB13 "
    "Y7 PB14 Y8 PB15 Y9 PB10 Y10 PB11 Y11 PB0 Y12 PB1 LED_RED PA13 LED_GREEN PA14"
)
TEENSY = (
    "D2 EMC_04 D3 EMC_05 D4 EMC_06 D5 EMC_08 D6 B0_10 D7 B1_01 D8 B1_00 D9 B0_11 D10 B0_00 "
    "D11 B0_02 D12 B0_01 D13 B0_03 D14 AD_B1_02 D15 AD_B1_03 D16 AD_B1_07 D22 AD_B1_08 "
    "D23 AD_B1_09 D24 AD_B0_12 D26 AD_B1_14 D27 AD_B1_15 D28 EMC_32 D29 EMC_31 D30 EMC_37 "
    "D31 EMC_36 D32 B0_12 D33 EMC_07 D34 B1_13 D35 B1_12 D36 B1_02 D37 B1_03"
)
NAMES = {"nucleo_g474re": NUCLEO, "pybv11": PYBOARD, "teensy41": TEENSY, "weact_h743": ""}


def found(board, name):
    """The processor's pin of a name; raises ValueError."""
    words = NAMES[board].split()
    for place in range(0, len(words), 2):
        if words[place] == name:
            return words[place + 1]
    if board == "teensy41" or name[0] not in "ABCDE" or not name[1:].isdigit():
        raise ValueError(f"Pin({name}) doesn't exist")
    return "P" + name
