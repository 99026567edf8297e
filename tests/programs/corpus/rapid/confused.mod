MODULE Confused (NOSTEPIN, VIEWONLY)
  CONST robtarget p:=<38|torch|wobj0>;
  ! CONST robtarget p:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST string s:="MoveL p,v1,fine,gripper; ""PROC x()""";
  LOCAL PERS num grid{2,3}:=[[1,2,3],[4,5,6]];
  PROC go()
    ConfL \Off; ConfJ\Off;
    SingArea\Wrist; AccSet 50, 80;
    again:
    MoveL p, v100, fine, torch; MoveL Offs(p,10,0,0), v100, fine, torch; ! MoveL p,v1,fine,tool0;
    IF grid{2,3}>5 GOTO again;
    TEST grid{1,1}
    CASE 1: MoveL Offs(p,0,10,0), v100, fine, torch;
    CASE 2,3: TPWrite s\Num:=grid{1,1};
    ENDTEST
    EXIT;
  ENDPROC
ENDMODULE
