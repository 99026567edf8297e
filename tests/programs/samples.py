"""Programs in the shape in which makers' manuals and controllers write them, and a robot that is easy to reckon with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calflow import Joint, Marker, Robot, dh
from calflow.programs import correction
from calflow.programs.aims import FilterSettings
from calflow.programs.calibrated_robot import Axes, CorrectedReadings
from calflow.programs.correction import Filtered
from calflow.programs.target import ArmPosture, Program

RAPID = """%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE Welding (SYSMODULE)
  ! MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]] is a remark
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];
  CONST robtarget p10:=[[600,-500,225.3],[0.7071068,0,0.7071068,0],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  LOCAL CONST robtarget path{2,2}:=[[[[  600.123 , 500.0, 225.30],[1,0,0,0],[1,1,0,0],[11,12.3,9E9,9E9,9E9,9E9]],
    [[.5E+03,500,225.3],[1,0,0,0],[1,1,0,0],[11,12.3,9E9,9E9,9E9,9E9]]],
    [[[600,500,225.3],[1,0,0,0],[1,1,0,0],[11,12.3,9E9,9E9,9E9,9E9]],
    [[6e2,500,225.3],[1,0,0,0],[1,1,0,0],[11,12.3,9E9,9E9,9E9,9E9]]]];
  CONST jointtarget home:=[[0,-30,+30.50,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  VAR robtarget here;
  PERS num z := 12.5;
  VAR robtarget shifted:=[[600,500,z],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  RECORD station
    robtarget place;
    num part;
  ENDRECORD

  PROC main()
    VAR num i:=0;
    ConfL \\Off;
    MoveAbsJ home\\NoEOffs, v1000, z50, gun;
    FOR i FROM 1 TO 2 DO
      MoveL path{i,1}, v200, fine, gun\\WObj:=fixture;
    ENDFOR
    IF DI_01=1 AND NOT (z>=3) THEN
      MoveJ p10, v1000, z50, gun \\WObj:=fixture;
    ELSEIF z=2 THEN
      TPWrite "p10:=[[600,-500,225.3]] \\5C ""quoted"" ! no remark";
    ELSE
      MoveC path{1,1}, path{2,2}, v500, z30, gun\\WObj:=fixture;
    ENDIF
    WHILE TRUE DO Stop; ENDWHILE
    TEST z
    CASE 1,2: MoveL Offs(p10,0,0,100), v500, z30, gun\\WObj:=fixture;
    DEFAULT: p10.trans.x:=500;
    ENDTEST
    here:=CRobT(\\Tool:=gun \\WObj:=fixture);
    MoveL [[700,100,300],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1000\\T:=5,z50,gun\\WObj:=fixture;
    again:
    IF z=0 GOTO again;
  ERROR
    RETRY;
  ENDPROC

  FUNC num twice(num x,\\switch loud|switch soft, VAR num list{*})
    RETURN 2*x;
  ENDFUNC
ENDMODULE
"""

KRL_DATA = """&ACCESS RVP
&REL 7
&COMMENT {X 1,Y 2} is no target
DEFDAT  WELD PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )
DECL INT SUCCESS
;ENDFOLD (EXTERNAL DECLARATIONS)
DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P2                      ",POINT2[] "P2 {X 1}"}
DECL E6POS XP1={X 1025.50,Y -12.25,Z 1300.000,A 178.5,B 30.0000,C -179.25,S 2,T 35,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
DECL PDAT PPDAT1={VEL 100.000,ACC 100.000,APO_DIST 100.000,APO_MODE #CDIS,GEAR_JERK 50.0000}
DECL GLOBAL POS XP2={X 900,Y 0,Z 1.1E3,A 0,B 90,C 0,S 'B010',T 'B100011'}
FDAT FP2={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}
E6AXIS XHOME={A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 -15,A6 0.0,E1 0.0}
DECL AXIS PARK={A1 10,A2 -80,A3 +95,A4 0,A5 5,A6 0}
DECL E6POS RACK[2]
RACK[1]={X 1000.0,Y 100.0,Z 900.0,A 90.0,B 0.0,C 180.0,S 2,T 2}
RACK[2]={E6POS: X 1000.0,Y 300.0,Z 900.0,A 90.0,B 0.0,C 180.0,S 2,T 2}
DECL FRAME FIXTURE={X 500.0,Y 0.0,Z 300.0,A 0.0,B 0.0,C 0.0}
DECL E6POS HALF={X 1.0,Y 2.0}
ENDDAT
"""

KRL = """&ACCESS RVP
DEF  WELD( )
DECL INT I
;FOLD INI
  GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
  INTERRUPT ON 3
  BAS (#INITMOV,0 )
;ENDFOLD (INI)
$TOOL={X 0.0,Y 0.0,Z 210.5,A 0.0,B -30.0,C 0.0}
$BASE={FRAME: X 500.0,Y 0.0,Z 300.0,A 0.0,B 0.0,C 0.0}
PTP  {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}
PTP  {X 100.0,Y 20.0,Z 40.0,A 0.0,B 90.0,C 0.0,S 2,T 35} C_PTP ; LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}
$VEL.CP=0.5
FOR I=1 TO 3
  LIN {X 100.00,Y 20.00,Z 41,A 0.0,B 89.0,C 0.0} C_DIS
  LIN_REL {Z 10}
ENDFOR
IF ($IN[1]==TRUE) AND NOT $IN[2] THEN
  CIRC {X 110.0,Y 20.0,Z 40.0,A 0.0,B 90.0,C 0.0}, {X 120.0,Y 30.0,Z 40.0,A 0.0,B 90.0,C 0.0}, CA 90.0
ELSE
  LIN XP1:{X 0,Y 0,Z 10,A 0,B 0,C 0}
ENDIF
WAIT SEC 0.5
LIN XP9
LIN {X 5.0}
END
DEFFCT REAL TWICE(X :IN)
DECL REAL X
RETURN (2*X)
ENDFCT
"""

FANUC = """/PROG  WELD\tMacro
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "P[1] X = 5 mm";
PROG_SIZE\t= 636;
CREATE\t\t= DATE 23-07-09  TIME 09:02:48;
LINE_COUNT\t= 9;
PROTECT\t\t= READ_WRITE;
DEFAULT_GROUP\t= 1,1,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
/APPL
/MN
   1:  UFRAME_NUM=1 ;
   2:  UTOOL_NUM=1 ;
   3:  !L P[4] INC is a remark ;
   4:J P[1] 100% FINE    ;
   5:L P[2:"seam, start"] 500mm/sec CNT100    ;
   6:C P[3]
    :  P[1] 100mm/sec FINE Offset,PR[1]    ;
   7:L P[5] 100mm/sec FINE INC    ;
   8:J PR[20] 25% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, -1',
\tX =  1171.166  mm,\tY =   539.539  mm,\tZ =  -538.770  mm,
\tW =  -175.187 deg,\tP =   -34.176 deg,\tR =     8.232 deg,
\tE1=    12.000  mm
   GP2:
\tUF : 1, UT : 1,\t
\tJ1=     6.425 deg
};
P[2:"seam, start"]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX = 1180.5 mm, Y = 540 mm, Z = -.25 mm, W = 180.000 deg, P = 0 deg, R = 0 deg
};
P[3]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=    25.000 deg,\tJ2=   -50.000 deg,\tJ3=    60.000 deg,
\tJ4=   -35.000 deg,\tJ5=   -45.000 deg,\tJ6=    50.000 deg
};
P[4]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =  ********  mm,\tY =  ********  mm,\tZ =  ********  mm,
\tW =  ******** deg,\tP =  ******** deg,\tR =  ******** deg
};
P[5]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =     0.000  mm,\tY =     0.000  mm,\tZ =    50.000  mm,
\tW =     0.000 deg,\tP =     0.000 deg,\tR =     0.000 deg
};
/END
"""

URSCRIPT = """def Weld():
  set_tcp(p[0.0,0.0,0.1635,0.0,0.0,0.0])
  set_payload(1.5, [0.0, 0.0, 0.05])
  global Waypoint_1_p=p[.433025361705, -.467959205379, .522310714714, 1.500318891221, .521427297251, .530987104689]
  global Waypoint_1_q=[1.9942498207092285, -1.66846146, 1.93304, -0.2718423169902344, 1.3209004, 0.0036]
  home = [d2r(-90), d2r(-120.5), 1.2, -1.6, -1.57, 0]
  feature = p[0.5, 0.1, 0, 0, 0, 0]
  thread watch():
    while (True):
      sync()
    end
  end
  watching = run watch()
  while (x < 3) and not done:
    $ 1 "Robot Program"
    $ 2 "Waypoint_1" "breakAfter"
    movej(get_inverse_kin(Waypoint_1_p, qnear=Waypoint_1_q), a=1.3962634015954636, v=1.0471975511965976)
    movej(home, a=1.4, v=1.05)  # movel(p[1, 2, 3, 0, 0, 0])
    movel(pose_trans(feature, p[0,0,-0.1,0,0,0]), a=1.2)
    movec(p[0.1,0.2,0.3,0,3.14,0], p[0.2, 0.2, +0.3, 0.0, 3.14, 0.0],
          a=1.2, v=0.25, r=0)
    movep(p[0.25, 0.2, 0.3, 2.2214, 2.2214, 0], a=1.2, v=0.25, r=0.01)
    movel(there)
    if (digital_in(3) == True):
      textmsg("movel(p[1,2,3,0,0,0]) # no remark")
    elif x != 2:
      x = x + 1
    else:
      movej([0.1, -1.57, 1.57 * 1, 0, 0, 0])
    end
  end
end
"""

EYE = np.eye(4)
FILES = {
    "weld.mod": (RAPID, FilterSettings({}, {}, tool="tool0", frame="wobj0")),
    "weld.dat": (KRL_DATA, FilterSettings({"1": EYE}, {"2": EYE}, tool="1", frame="2")),
    "weld.src": (KRL, FilterSettings({}, {}, tool="0", frame="0")),
    "weld.ls": (FANUC, FilterSettings({"1": EYE}, {"1": EYE})),
    "weld.script": (URSCRIPT, FilterSettings({}, {})),
}


SIX = Robot((Joint(dh(d=0.1), limits=(-3.0, 3.0)),) * 6, markers={"tool": Marker((0.0, 0.0, 0.0))})


@dataclass(frozen=True)
class Hand:
    """A hand that goes anywhere: its joint readings are its place [m] and its rotation vector [rad], and each is off by a shift."""

    shift: tuple[float, ...] = (0.0,) * 6

    @property
    def axes(self) -> Axes:
        """Six with limits, and nothing else."""
        return Axes(SIX)

    def flange(self, readings: np.ndarray) -> np.ndarray:
        """Transforms of readings."""
        poses = np.tile(np.eye(4), (len(readings), 1, 1))
        poses[:, :3, 3] = readings[:, :3]
        poses[:, :3, :3] = Rotation.from_rotvec(readings[:, 3:]).as_matrix()
        return poses

    def solutions(
        self, flanges: np.ndarray, starts: int, near: list[np.ndarray | None], external: np.ndarray
    ) -> list[np.ndarray]:
        """The one way to each pose."""
        turns = Rotation.from_matrix(flanges[:, :3, :3]).as_rotvec()
        return [np.concatenate([pose[:3, 3], turn])[None] for pose, turn in zip(flanges, turns, strict=True)]

    def continued(self, flanges: np.ndarray, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The one way to each pose."""
        return np.concatenate(self.solutions(flanges, 0, [], begun)), np.arange(len(flanges))

    def postures(self, readings: np.ndarray) -> list[ArmPosture]:
        """No arm at all."""
        return [ArmPosture((), None, None)] * len(readings)

    def corrected(
        self, readings: np.ndarray, tools: np.ndarray, names: list[str], runs: list[list[int]]
    ) -> CorrectedReadings:
        """Readings with the shift, and nothing in the way."""
        n = len(readings)
        shifted = readings + np.array(self.shift)
        return CorrectedReadings(shifted, tuple(shifted[:, None]), np.zeros(n), np.zeros((n, 3)), (None,) * n, ())


def filtered(program: Program, corrector: Hand, choices: FilterSettings) -> Filtered:
    """A program by itself, corrected."""
    return correction.filtered([program], corrector, choices)
